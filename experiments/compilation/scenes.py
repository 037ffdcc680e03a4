"""The compiled scenes: README's example with other depths, estimators, and a mirror, a lens, or textures and a sky.

jaxdr is only imported when it is used, since a study chooses its version (`trees.py`).
"""

import numpy as np

# name: scene, arguments of PathTracer
CASES = {
    "README": ("plain", {}),
    "README, depth 2": ("plain", {"max_depth": 2}),
    "README, LineSampling": ("plain", {"boundary": "LineSampling"}),
    "README, GuidedEdges": ("plain", {"boundary": "GuidedEdges"}),
    "mirror": ("mirror", {}),
    "glass lens, depth 4": ("lens", {"max_depth": 4}),
    "textures and sky": ("textures", {}),
}
MOVING = "ball.vertices"


def built(name: str, size: int):
    """(scene of `size` x `size` pixels, integrator) of a case."""
    import jaxdr as jd

    kind, settings = CASES[name]
    if "boundary" in settings:
        settings = settings | {"boundary": getattr(jd, settings["boundary"])()}
    return scene_of(kind, jd.Film(size, size)), jd.PathTracer(**settings)


def scene_of(kind: str, film):
    """README's scene ("plain"), or one with a "mirror" or a "lens" more, or with "textures" under a sky."""
    import jaxdr as jd

    ball = jd.Shape(jd.shapes.sphere(3, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse((0.8, 0.5, 0.3)))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    shapes = {"ball": ball, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0))}
    environment = None
    if kind == "mirror":
        mirror = jd.shapes.sphere(3, radius=0.5, center=(-1.1, 0.3, 0.5))
        shapes["mirror"] = jd.Shape(mirror, jd.Conductor("Al"))
    elif kind == "lens":
        place = np.diag([0.5, 0.1, 0.5, 1.0])
        place[:3, 3] = 0.0, -1.6, 1.3  # between the camera and the ball
        shapes["lens"] = jd.Shape(jd.shapes.transformed(jd.shapes.sphere(3), place), jd.Dielectric())
    elif kind == "textures":
        random = np.random.default_rng(0)
        colors = jd.VertexColors(random.uniform(0.2, 0.8, (len(ball.mesh.vertices), 3)))
        image = jd.Bitmap(random.uniform(0.2, 0.8, (64, 64, 3)))
        shapes = {"ball": jd.Shape(ball.mesh, jd.Diffuse(colors))}
        shapes["floor"] = jd.Shape(floor.mesh, jd.TwoSided(jd.Diffuse(image)))
        environment = jd.EnvironmentMap(random.uniform(0.0, 2.0, (16, 32, 3)))
    camera = jd.Perspective(jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), fov=35.0, film=film)
    return jd.Scene(shapes, camera, environment)


def loss_of(scene, integrator, spp: int, target):
    """README's loss: (offset [3] of the ball, key) -> mean squared difference to `target` [H, W, 3]."""
    import jaxdr as jd

    vertices = scene.parameters()[MOVING]

    def loss(offset, key):
        moved = scene.replace({MOVING: vertices + offset})
        return jd.losses.l2(jd.render(moved, key, spp, integrator), target)

    return loss
