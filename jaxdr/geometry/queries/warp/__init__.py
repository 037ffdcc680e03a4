"""Queries by Warp, on CPU and CUDA.

`queries` has one function for each query. It finds the structures over faces in `structures` (kept by content, refitted
by `tree_kernels`), and launches `kernels` and `sector_kernels` by `launch`, which slices batches over threads on CPUs.
`records` shows JAX's arrays to the kernels as structs. Files of kernels are in Warp's language: no type checker reads
this folder.
"""
