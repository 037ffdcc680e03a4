"""The ten scenes of the study, reference scenes and procedural ones, and what moves in each."""

import json
import math

from experiments.reference_scenes import SCENES as REFERENCES

# Motion and longest path; those of the reference scenes are in their oracle.json.
PROCEDURAL = {
    "hard_lamp": ("ball.translate.x", 2),
    "soft_lamp": ("ball.translate.x", 2),
    "point_light": ("ball.translate.x", 2),
    "room": ("ball.translate.x", 2),
}
SCENES = (*REFERENCES, *PROCEDURAL)


def load(name, oracle):
    """(scene, parameter or motion, longest path)."""
    import jaxdr as jd
    from jaxdr.chart.scenes import ball_and_shadow
    from jaxdr.optimize.recovery.scenes import still_life

    if name in REFERENCES:
        folder = oracle / name
        scene = jd.load_mitsuba(str(folder / "scene.xml"))
        table = json.loads((folder / "oracle.json").read_text())
        rigid = next(p for p in table["parameters"] if p["kind"] in ("translate", "rotate"))
        return scene, f"{rigid['shape']}.{rigid['kind']}.{_axis(rigid)}", table["max_depth"]
    made = {
        "hard_lamp": lambda: ball_and_shadow(light=0.1),
        "soft_lamp": lambda: ball_and_shadow(light=1.8),
        "point_light": lambda: still_life(resolution=32),
        "room": lambda: room(4, 3),
    }[name]()
    return made, *PROCEDURAL[name]


def _axis(rigid):
    vector = rigid["direction"] if rigid["kind"] == "translate" else rigid["axis"]
    return "xyz"[max(range(3), key=lambda k: abs(vector[k]))]


def room(statues, subdivisions, resolution=32):
    """A `ball` of 1,280 faces among statues of 20 x 4^`subdivisions` faces each, under a lamp."""
    import jaxdr as jd
    from jaxdr.geometry import shapes
    from jaxdr.scene.camera import look_at

    grey = jd.TwoSided(jd.Diffuse(0.5))
    found = {"ball": jd.Shape(shapes.displaced_sphere(3, radius=0.35, center=(0, 0, 0.4)).flat(), grey)}
    for i in range(statues):
        angle = 2 * math.pi * (i + 0.5) / statues
        centre = (1.3 * math.cos(angle), 1.3 * math.sin(angle), 0.4)
        found[f"statue_{i}"] = jd.Shape(shapes.displaced_sphere(subdivisions, radius=0.35, center=centre).flat(), grey)
    lamp = shapes.transformed(shapes.rectangle(0.8, 0.8), look_at((0.4, -0.3, 3.0), (0, 0, 0), (0, 1, 0)))
    found["floor"] = jd.Shape(shapes.plane(8.0), grey)
    found["lamp"] = jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(10.0))
    camera = jd.Perspective(look_at((0, -4.5, 2.6), (0, 0, 0.2), (0, 0, 1)), 40.0, jd.Film(resolution, resolution))
    return jd.Scene(found, camera)


def everything():
    """One of each model that can be differentiated together, direct light: what a program with all of it holds."""
    import numpy as np

    import jaxdr as jd
    from jaxdr.geometry import shapes
    from jaxdr.geometry.uvs import spherical_uvs
    from jaxdr.optimize.recovery.scenes import patches

    plain = diffuse()
    bitmap = jd.Bitmap(patches(4))
    models = {
        "conductor": jd.RoughConductor(0.2),
        "dielectric": jd.Dielectric(1.5),
        "mirror": jd.Conductor(),
        "plastic": jd.Plastic(),
        "principled": jd.Principled(),
        "rough_plastic": jd.RoughPlastic(0.2),
        "textured": jd.Diffuse(bitmap),
    }
    found = dict(plain.shapes)
    for number, (name, bsdf) in enumerate(models.items()):
        mesh = shapes.sphere(1, radius=0.3, center=(number - 3.0, 1.5, 0.0)).smooth()
        found[name] = jd.Shape(spherical_uvs(mesh), bsdf)
    glowing = spherical_uvs(shapes.sphere(1, radius=0.3, center=(0.0, 2.5, 2.0)))
    found["glowing"] = jd.Shape(glowing, jd.Diffuse(0.0), jd.AreaEmitter(bitmap))
    sky = jd.EnvironmentMap(np.full((4, 8, 3), 0.5))
    return jd.Scene(found, plain.camera, sky, {"point": jd.PointLight([0, -2.0, 3.0], 5.0)})


def diffuse():
    """A diffuse ball above a floor, direct light of a rectangle."""
    import jaxdr as jd
    from jaxdr.geometry import shapes
    from jaxdr.scene.camera import look_at

    lamp = shapes.transformed(shapes.rectangle(0.8, 0.8), look_at((0.4, -0.3, 3.0), (0, 0, 0), (0, 1, 0)))
    found = {
        "ball": jd.Shape(shapes.sphere(1, radius=0.5)),
        "floor": jd.Shape(shapes.plane(8.0, center=(0.0, 0.0, -0.6))),
        "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(10.0)),
    }
    return jd.Scene(found, jd.Perspective(look_at((0, -5, 2), (0, 0, 0), (0, 0, 1)), 40.0, jd.Film(16, 16)))
