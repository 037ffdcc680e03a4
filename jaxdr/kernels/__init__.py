"""Row kernels: what a program computes for every row (path, ray, edge) becomes a few vector kernels.

`fused` takes the jaxpr of a function. `flatten` makes one list of its equations, `rows` tells which are arithmetic on
rows, `levels` gathers these in kernels, `operations` and `text` write them as C++, `machine` compiles and keeps them,
and `program` calls them from XLA. Nothing here knows of rendering.
"""

from jaxdr.kernels.choice import CHOICES as CHOICES
from jaxdr.kernels.choice import computed as computed
from jaxdr.kernels.fused import fused as fused
