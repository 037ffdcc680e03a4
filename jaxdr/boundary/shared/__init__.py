"""What several estimators stand on; nothing here imports from them.

`term` is the interface: prepare once, draw points and ask for radiance, say what the answers are worth. `path_segments`
gives both ends of every segment, `projection` projects edges from the near to the far end, `on_planes` and `background`
say what a boundary point carries and how fast it moves, where light comes from emitters and from past the edge.
`texture_jumps`, `folds` and `edge_reservoir` choose edges; `blocks` and `allocation` spend work where there is some.
"""
