"""Settings of path tracing."""

from typing import NamedTuple


class PathSettings(NamedTuple):
    """Static settings of paths.

    - `max_depth`: in segments. `mis`: emitter sampling and BSDF sampling, or emitter sampling alone.
    - `rays`: the implementation of queries.
    - `records`: whether the segments of paths are kept.
    - `pairs`: whether narrow lobes have the derivatives of antithetic pairs, see `mirrored_pairs`. Values stay as they
      are.
    - `black`: whether paths go on where their throughput is zero, because its derivative may not be: a reflectance may
      be differentiated where it is zero. Otherwise they end there.
    """

    max_depth: int
    mis: bool
    rays: str
    records: bool = True
    pairs: bool = False
    black: bool = False
