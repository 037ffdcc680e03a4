"""Terms of what the film sees, for every estimator alike: lines in the image, with both sides.

`film_edges` draws points on silhouettes and creases by `edge_distribution`; `film_chains` finds edges seen in mirrors
and through smooth glass. `hard_shadows` follows what lights without area leave dark, on the film and on the surfaces
that paths meet, by `shadow_lines`; `pixel_borders` is light that moves through the border of a pixel. Every term asks
for the radiance of the two sides and splats their difference times the velocity of the line.
"""
