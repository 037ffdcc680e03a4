"""Nearest hits and occlusion by Embree on CPUs; the other queries are those of `warp`.

`scene` holds a mesh in Embree's library, which is in the package `embreex`. `native` has the handlers that XLA calls,
and keeps scenes by the content of their geometry. `queries` is the interface.
"""
