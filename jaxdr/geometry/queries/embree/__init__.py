"""Nearest hits and occlusion by Embree on CPUs; the other queries are those of `warp`.

`scene` holds a mesh in Embree's library, which `embreex` brings along. `queries` keeps scenes by the content of their
geometry, and launches `kernels`, Warp kernels that hand packets of 16 rays to the library.
"""
