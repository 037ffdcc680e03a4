"""The run-time type checker of the tests: beartype, which leaves NumPy's ArrayLike alone.

ArrayLike is written for static checkers: at run time it refuses floats and tuples.
"""

from beartype import BeartypeConf, FrozenDict, beartype
from numpy.typing import ArrayLike

check = beartype(conf=BeartypeConf(hint_overrides=FrozenDict({ArrayLike: object, ArrayLike | None: object})))
