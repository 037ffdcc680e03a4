"""Meshes and what is asked about them; the first room, which knows no scene.

`mesh` is the triangle mesh, which `load` reads from files (`gltf/`: glTF as it is stored), `shapes` makes and `uvs`
unwraps. `edges` lists its edges, `edge_tree` bounds them in a tree. `queries/` answers which face a ray hits and which
edges bound what is seen. `vector` is the algebra of 3-vectors that everything uses.
"""
