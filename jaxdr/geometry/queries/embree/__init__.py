"""Nearest hits and occlusion by Embree on CPUs; the other queries are those of `warp`.

`scene` holds a mesh in Embree's library, which is in the package `embreex`. `queries` keeps scenes by the content of
their geometry. It launches `kernels`, which are Warp kernels that pass packets of 16 rays to the library.
"""
