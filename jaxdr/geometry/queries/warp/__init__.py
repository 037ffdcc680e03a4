"""Queries by Warp, on CPU and CUDA.

`queries` has one function for each query. It finds the structures over faces in `structures` (kept by content, refitted
by `tree_kernels`), and launches `kernels`, `sector_kernels` and `bundle_kernels` by `launch`, which slices batches
over threads on CPUs. `records` passes JAX's arrays to the kernels as structs. Kernels are in Warp's language, so type
checkers skip this folder.
"""

from jaxdr.quiet_warp import start_warp

start_warp()
