"""Meshes, and queries about them. This package does not depend on scenes.

- `mesh`: the triangle mesh. `load` reads it from files (`gltf/` reads glTF), `shapes` makes it, `uvs` unwraps it.
- `edges`: the edges of a mesh; `edge_tree`: a bounding tree over edges.
- `queries/`: which face a ray hits, and which edges bound what is seen.
- `vector`: algebra of 3-vectors.
"""
