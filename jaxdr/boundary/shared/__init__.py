"""What several estimators share; nothing here imports from them.

- `term`: the interface. A term is prepared once, draws points and requests radiance, and makes an image of the answers.
- `path_segments`: both ends of every segment; `projection`: edges projected from the near end to the far end.
- `on_planes`, `background`: contribution and velocity of boundary points, on the far end's plane and before a traced
  background.
- `sampled_arcs`: kernels along arcs of directions.
- `emitter_planes`, `face_neighbours`: which emitting faces lie in one plane, and which faces meet at an edge.
- `texture_jumps`, `folds`, `edge_table`: which edges count.
- `blocks`, `allocation`: spend work where it is needed.
- `refusals`: what an estimator does not cover.
"""
