"""The walls of `cornell_indirect`, from the measurements of the Cornell box that Cornell University published.

    python experiments/data/reference_scenes/cornell_box.py

It writes an OBJ file for each wall beside the scene. The scene's references were made with these vertices in this
order: sorted, in units of 555 mm, with six decimals.
"""

from pathlib import Path

FOLDER = Path(__file__).parent / "cornell_indirect"
UNIT = 555.0  # mm

# Quadrilaterals in mm. The x axis points to the left wall (red), y up, and z into the box.
WALLS = {
    "floor": [[(552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)]],
    "ceiling": [
        [(556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0)],
        [(213, 548.8, 227), (213, 548.8, 332), (343, 548.8, 332), (343, 548.8, 227)],  # where the box had its lamp
    ],
    "back": [[(549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2)]],
    "greenwall": [[(0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2)]],
    "redwall": [[(552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0)]],
}


def obj(quads):
    """Quadrilaterals as text: their vertices, then the first triangles of all of them, then the second ones."""
    vertices = sorted({vertex for quad in quads for vertex in quad})
    number = {vertex: count for count, vertex in enumerate(vertices, 1)}
    triangles = [(a, b, c) for a, b, c, _ in quads] + [(c, d, a) for a, _, c, d in quads]
    lines = [f"v {' '.join(f'{coordinate / UNIT:.6f}' for coordinate in vertex)}" for vertex in vertices]
    lines += [f"f {' '.join(str(number[vertex]) for vertex in triangle)}" for triangle in triangles]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    for name, quads in WALLS.items():
        (FOLDER / f"{name}.obj").write_text(obj(quads))
