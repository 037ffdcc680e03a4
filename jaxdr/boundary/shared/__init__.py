"""What several estimators share; nothing here imports from them.

- `term`: the interface. Prepare once, draw points and ask for radiance, say what the answers are worth.
- `path_segments`: both ends of every segment; `projection`: edges projected from the near to the far end.
- `on_planes`, `background`: what a boundary point carries and how fast it moves, for light from emitters and from past
  the edge.
- `texture_jumps`, `folds`, `edge_reservoir`: which edges count.
- `blocks`, `allocation`: work is spent where there is some.
"""
