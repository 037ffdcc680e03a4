"""Queries in plain JAX: the reference for tests, for tiny scenes, and for devices that Warp does not know.

`queries` has one function for each query; every face and edge is tried, in blocks. `sector` is the longest of them:
edges that cut planar sectors.
"""
