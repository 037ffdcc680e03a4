"""Queries in plain JAX: the reference for tests, for tiny scenes, and for devices that Warp does not support.

`queries` has one function for each query. It tries every face and edge, in blocks. `sector` has the longest query:
edges that cut planar sectors. `bundles` walks a tree over edges.
"""
