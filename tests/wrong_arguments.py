"""Every public constructor and function, with one argument after another replaced by a value of a wrong kind.

A program, because the tests' type checker would come first: `tests/test_argument_kinds.py` runs it, in an empty folder.
It prints a line of JSON for every outcome that is no clear refusal.
"""

import inspect
import json
import math
import re
import typing
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.views.pictures import Pixels
from tests.views.folders import write_nerf

POSE = jd.look_at((0, -4, 1), (0, 0, 0), (0, 0, 1))
FILM, KEY, PICTURE = jd.Film(4, 4), jax.random.key(0), np.full((4, 4, 3), 0.5, np.float32)
BALL, IMAGE = jd.shapes.sphere(0), jnp.full((4, 4, 3), 0.5)
SHAPE = jd.Shape(BALL)
SCENE = jd.Scene({"ball": SHAPE}, jd.Perspective(POSE, 40.0, FILM), jd.ConstantEnvironment())
FACES, MATRIX = [[0, 1, 2]], np.eye(4)
GREY = PICTURE[..., 0]
VIEWS = [jd.View("photograph", Path("p.png"), Pixels(PICTURE), POSE, 4.0, (2.0, 2.0))]
GUIDES = jd.build_guides(SCENE, jd.GuidedEdges())

# Name -> arguments that are right. Those that are left out have defaults; they are replaced as well.
VALID: dict[str, dict[str, Any]] = {
    "AllSilhouettes": {},
    "AreaEmitter": {"radiance": 1.0},
    "BidirectionalPathTracer": {},
    "Bitmap": {"pixels": PICTURE},
    "Blend": {"weight": 0.5, "first": jd.Diffuse(), "second": jd.Diffuse()},
    "Box": {},
    "BumpMap": {"height": jd.Bitmap(GREY), "bsdf": jd.Diffuse()},
    "ByKind": {},
    "Checkerboard": {},
    "Conductor": {},
    "ConstantEnvironment": {},
    "Dielectric": {},
    "Diffuse": {},
    "DirectionalLight": {"direction": (0, 0, -1)},
    "EnvironmentMap": {"radiance": PICTURE},
    "FaceColors": {"colors": PICTURE[0]},
    "Film": {"width": 4, "height": 4},
    "Gaussian": {},
    "GuidedEdges": {},
    "KernelDensity": {},
    "LargeSteps": {"mesh": BALL},
    "LineSampling": {},
    "MarkovChains": {},
    "Mask": {"opacity": 0.5, "bsdf": jd.Diffuse()},
    "Mesh": {"vertices": np.eye(3), "faces": FACES, "uvs": np.eye(3)[:, :2], "uv_faces": FACES, "normal_faces": FACES},
    "NormalMap": {"normal": jd.Bitmap(PICTURE), "bsdf": jd.Diffuse()},
    "Orthographic": {"to_world": POSE, "film": FILM},
    "PathTracer": {},
    "Perspective": {"to_world": POSE, "fov": 40.0, "film": FILM},
    "Phong": {},
    "Plastic": {},
    "Picture": {"images": PICTURE},
    "PointLight": {"position": (0, 0, 1)},
    "Principled": {},
    "Product": {"first": jd.Bitmap(PICTURE), "second": jd.Bitmap(PICTURE)},
    "Projector": {"irradiance": PICTURE, "to_world": POSE, "fov": 40.0},
    "QuadricSampling": {},
    "RednerWAS": {},
    "RoughConductor": {},
    "RoughDielectric": {},
    "RoughPlastic": {},
    "Scene": {"shapes": {"ball": SHAPE}, "camera": SCENE.camera},
    "Shape": {"mesh": BALL},
    "SpotLight": {"position": (0, 0, 1), "direction": (0, 1, 0)},
    "Tent": {},
    "TexturedSpotLight": {"position": (0, 0, 1), "direction": (0, 1, 0), "texture": PICTURE, "up": (0, 0, 1)},
    "ThinDielectric": {},
    "ThinLens": {"to_world": POSE, "fov": 40.0, "film": FILM, "aperture_radius": 0.1, "focus_distance": 3.0},
    "TwoSided": {"bsdf": jd.Diffuse()},
    "VertexColors": {"colors": PICTURE[0]},
    "WalkOnCaps": {},
    "WarpedArea": {},
    "adam_uniform": {"learning_rate": 0.1},
    "build_guides": {"scene": SCENE, "boundary": jd.GuidedEdges()},
    "chamfer": {"mesh": BALL, "target": BALL, "samples": 3},
    "derivative_terms": {"scene": SCENE, "key": KEY},
    "evaluate_views": {"scene": SCENE, "views": VIEWS},
    "guide_report": {"scene": SCENE, "boundary": jd.GuidedEdges()},
    "jit": {"function": abs},
    "load_gltf": {"path": "asset.glb"},
    "load_image": {"path": "picture.png"},
    "load_mesh": {"path": "mesh.obj"},
    "load_mitsuba": {"path": "scene.xml"},
    "load_shape": {"path": "mesh.obj"},
    "load_views": {"folder": "photographs"},
    "look_at": {"origin": (0, -4, 1), "target": (0, 0, 0), "up": (0, 0, 1)},
    "losses.l1": {"image": IMAGE, "target": IMAGE, "mask": IMAGE[..., 0]},
    "losses.l2": {"image": IMAGE, "target": IMAGE, "mask": IMAGE[..., 0]},
    "losses.two_key_l2": {"image_a": IMAGE, "image_b": IMAGE, "target": IMAGE, "mask": IMAGE[..., 0]},
    "losses.without": {"ignored": IMAGE[..., 0] > 1, "images": (IMAGE,)},
    "move": {"scene": SCENE, "motions": {"ball.scale": 2.0}},
    "plan": {"scene": SCENE},
    "refit_guides": {"scene": SCENE, "guides": GUIDES, "key": KEY},
    "remesh": {"mesh": BALL, "edge_length": 0.5},
    "remesh_field_aligned": {"mesh": BALL, "vertices": 20},
    "render": {"scene": SCENE, "key": KEY},
    "render_aovs": {"scene": SCENE, "key": KEY},
    "render_views": {"scene": SCENE, "views": VIEWS},
    "save_gltf": {"path": "out.glb", "shapes": {"ball": SHAPE}},
    "save_mesh": {"path": "out.obj", "mesh": BALL},
    "shapes.box": {},
    "shapes.centred": {"mesh": BALL, "size": 1.0},
    "shapes.displaced_sphere": {"subdivisions": 1},
    "shapes.duck": {"subdivisions": 1},
    "shapes.pawn": {},
    "shapes.plane": {},
    "shapes.rectangle": {},
    "shapes.revolved": {"profile": [[0, 0], [1, 0], [0, 1]]},
    "shapes.sphere": {"subdivisions": 1},
    "shapes.star": {},
    "shapes.torus": {},
    "shapes.transformed": {"mesh": BALL, "matrix": MATRIX},
    "shapes.trefoil_tube": {},
    "working": {"text": "compiling"},
    "write_image": {"path": "out.npy", "image": PICTURE},
}


class Nothing:
    """An object of no known kind."""


WRONG: dict[str, Any] = {
    "a name": "wood.png",
    "None": None,
    "a ragged list": [[1.0, 2.0], [3.0]],
    "an object": Nothing(),
    "a dictionary": {"a": 1},
    "a shape": np.zeros((2, 5, 7)),
    "NaN": math.nan,
    "a class": jd.Diffuse,
    "a function": math.sqrt,
    "a boolean": True,
    "a complex number": 1j,
    "a fraction": 2.5,
    "a negative number": -3,
    "a huge number": 10**30,
}


def function(name: str) -> Any:
    """The function or class of a name of `VALID`."""
    found = jd
    for part in name.split("."):
        found = getattr(found, part)
    return found


def outcomes(name: str):
    """(parameter, kind of the value, what is wrong with what happens) for every wrong value."""
    called, valid = function(name), VALID[name]
    for parameter in inspect.signature(called).parameters.values():
        if parameter.kind == parameter.VAR_KEYWORD:
            continue
        for kind, value in WRONG.items():
            if kind not in allowed(name, parameter):
                found = outcome(called, valid, parameter, value)
                if found is not None:
                    yield parameter.name, kind, found


NUMBERS = {"a fraction", "a negative number", "a huge number"}


def allowed(name: str, parameter: inspect.Parameter) -> set[str]:
    """Kinds of values that are right by the annotation of a parameter, or may be."""
    kinds = kinds_of(parameter)
    found = set(ALLOWED.get(f"{name}.{parameter.name}", ()))
    if parameter.default is None or type(None) in kinds:
        found |= {"None"}
    if bool in kinds:
        found |= {"a boolean"}
    if int not in kinds and inspect.isfunction(function(name)) and not name.startswith("shapes."):
        found |= NUMBERS  # they may be right, and then the function takes its time
    return found


# Beyond what annotations say. A shape may be so large that no face of it has an area in float32, as `Mesh` says.
ALLOWED = {
    "Picture.titles": {"a name"},
    "working.text": {"a name"},
    "BidirectionalPathTracer.boundary": {"None"},
    "PathTracer.boundary": {"None"},
    "adam_uniform.learning_rate": {"a function"},
    "evaluate_views.seed": {"a negative number"},
    "jit.function": {"a class", "a function"},
    "load_views.holdout": {"a name"},
    "plan.boundary": {"None"},
    "render_views.seed": {"a negative number"},
    "shapes.rectangle.height": {"a huge number"},
    "shapes.rectangle.width": {"a huge number"},
    "shapes.star.outer_radius": {"a huge number"},
    "shapes.torus.major_radius": {"a huge number"},
    "write_image.image": {"a shape"},
    "write_image.path": {"a name"},
}


def outcome(called, valid, parameter: inspect.Parameter, value) -> str | None:
    """None for a clear refusal, else what happened."""
    given = valid | {parameter.name: value}
    signature = inspect.signature(called)
    bound = signature.bind_partial()
    bound.arguments.update({n: given[n] for n in signature.parameters if n in given})
    if parameter.kind == parameter.VAR_POSITIONAL:
        bound.arguments[parameter.name] = (value,)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            called(*bound.args, **bound.kwargs)
    except Exception as error:
        return unclear(error, called.__name__, parameter.name, value)
    # A number of another sign or size may be right; what is no number is not.
    return None if int not in kinds_of(parameter) and is_number(value) else "accepted"


def kinds_of(parameter: inspect.Parameter) -> set[Any]:
    """The parts of an annotation."""
    return {parameter.annotation} | set(typing.get_args(parameter.annotation))


def is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def unclear(error: Exception, owner: str, parameter: str, value) -> str | None:
    """None for a refusal in one line that names function or class and parameter. A file is named by its path alone."""
    text = f"{type(error).__name__}: {error}"
    if not isinstance(error, ValueError | TypeError | FileNotFoundError):
        return f"other error: {text}"
    if "\n" in str(error):
        return f"several lines: {text}"
    named = [str(value)] if isinstance(value, str) else [repr(key) for key in value] if isinstance(value, dict) else []
    if parameter in ("path", "folder", "masks") and any(name in text for name in named):
        return None
    if not re.search(rf"\b{owner}\b", text) and "asset.glb: " not in text and "scene.xml, " not in text:
        return f"no owner: {text}"
    if not re.search(rf"\b{parameter}\b", text) and not any(name in text for name in named):
        return f"no parameter: {text}"
    return None


def write_files() -> None:
    """What the functions that read files are to read."""
    jd.save_gltf("asset.glb", {"ball": SHAPE})
    jd.save_mesh("mesh.obj", BALL)
    jd.write_image("picture.png", PICTURE)
    Path("scene.xml").write_text('<scene version="3.0.0"><sensor type="perspective"/><shape type="sphere"/></scene>')
    write_nerf(Path("photographs"))


if __name__ == "__main__":
    write_files()
    for name in VALID:
        for parameter, kind, found in outcomes(name):
            print(json.dumps([name, parameter, kind, found]), flush=True)
