"""Terms of the lines at which the image itself jumps. They are the same for every estimator.

- `film_edges`: silhouettes and creases that the camera sees directly; `edge_distribution` is what they are drawn from.
- `film_chains`: edges seen in mirrors and through smooth glass.
- `hard_shadows`: shadows of lights without area, on the film and on the surfaces that paths meet; `shadow_lines` draws
  points on their edges.
- `pixel_borders`: light that moves through the border of a pixel.

The first three splat the jump of radiance across a line times the line's normal velocity.
"""
