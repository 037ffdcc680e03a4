"""Draws the figures of README and docs/how_it_works.md: `python docs/tools/figures.py`, from the checkout's root."""

import io
import json
from base64 import b64decode
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from PIL import Image

import jaxdr as jd

matplotlib.use("Agg")
import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parents[1] / "figures"
STEP, SPP, CALLS = 0.004, 128, 16
INK, GLOW, SHADE, GOOD = "#333333", "#e6a700", "#9db4c8", "#c0392b"


def scene_of_the_readme() -> jd.Scene:
    """The ball, floor and lamp of README's example, behind a box filter."""
    ball = jd.Shape(jd.shapes.sphere(3, radius=0.5, center=(0.0, 0.0, 0.8)), jd.Diffuse((0.8, 0.5, 0.3)))
    floor = jd.Shape(jd.shapes.plane(10.0), jd.TwoSided(jd.Diffuse(0.5)))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    shapes = {"ball": ball, "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0))}
    film = jd.Film(128, 128, jd.Box())
    return jd.Scene(shapes, jd.Perspective(jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), fov=35.0, film=film))


def terms() -> dict[str, np.ndarray]:
    """Derivative images [H, W] by a motion of the ball along x: every term, and finite differences of the image."""
    scene = scene_of_the_readme()
    vertices = scene.parameters()["ball.vertices"]
    tracer = jd.PathTracer(max_depth=2)
    only_the_ball = jd.Moving(shapes=(True, False, False), camera=False, lights=(), environment=False)

    def moved(x):
        return scene.replace({"ball.vertices": vertices + x * jnp.array([1.0, 0.0, 0.0])})

    @jax.jit
    def derivatives(key):
        def images(x):
            return {k: v.mean(-1) for k, v in jd.derivative_terms(moved(x), key, SPP, tracer, only_the_ball).items()}

        return jax.jvp(images, (0.0,), (1.0,))

    @jax.jit
    def image(x, key):
        return jd.render(moved(x), key, 4 * SPP, jd.PathTracer(max_depth=2, boundary=None)).mean(-1)

    keys = jax.random.split(jax.random.key(1), CALLS)
    values, tangents = zip(*(derivatives(key) for key in keys), strict=True)
    found = {name: np.mean([tangent[name] for tangent in tangents], 0) for name in tangents[0]}
    differences = np.mean([image(STEP, key) - image(-STEP, key) for key in keys], 0) / (2 * STEP)
    picture = np.mean([value["interior"] for value in values], 0)
    return {"image": picture, **found, "sum of the terms": sum(found.values()), "finite differences": differences}


def draw_terms() -> None:
    """The image, the terms of its derivative, their sum, and finite differences."""
    images = terms()
    names = ["image", "interior", "silhouettes", "creases", "boundary", "sum of the terms", "finite differences"]
    names.append("their difference")
    images["their difference"] = images["sum of the terms"] - images["finite differences"]
    figure, axes = plt.subplots(2, 4, figsize=(12, 6.3), layout="constrained")
    for axis, name in zip(axes.flat, names, strict=True):
        if name == "image":
            axis.imshow(np.clip(1.5 * images[name], 0, 1) ** (1 / 2.2), cmap="gray", vmin=0, vmax=1)
        else:
            axis.imshow(images[name], cmap="RdBu_r", vmin=-1.5, vmax=1.5)
        axis.set_title(name.replace("boundary", "boundary (the shadow)"))
    for axis in axes.flat:
        axis.set_axis_off()
    figure.savefig(FOLDER / "terms.png", dpi=80)


def _scene_of(axis, title: str) -> None:
    """A point x on the ground, a blocker above it, and a light over both; the boundary is where the blocker ends."""
    axis.set_title(title, fontsize=11)
    axis.plot([-0.3, 3.3], [0, 0], color=INK, lw=2)
    axis.plot([0.4, 3.1], [3, 3], color=GLOW, lw=5, solid_capstyle="butt")
    axis.add_patch(plt.Circle((0.35, 1.35), 0.55, color=SHADE))
    axis.plot(1.0, 0, "o", color=INK)
    axis.text(1.05, -0.32, "$x_{K+1}$", fontsize=11)
    axis.set(xlim=(-0.4, 3.4), ylim=(-0.5, 3.5), aspect="equal")
    axis.set_axis_off()


def draw_estimators() -> None:
    """What the four estimators do with one path vertex, one blocker and one light, in a plane."""
    apex, edge = np.array([1.0, 0.0]), np.array([0.9, 1.35])  # the ball's silhouette as the point sees it
    edge = np.array([0.35, 1.35]) + 0.55 * np.array([0.985, 0.17])
    boundary = apex + (edge - apex) * 3 / edge[1]
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.9), layout="constrained")
    titles = ["KernelDensity: a strip", "LineSampling: a chord", "GuidedEdges: from the edge", "WarpedArea: a velocity"]
    for axis, title in zip(axes, titles, strict=True):
        _scene_of(axis, title)
        axis.plot(*zip(apex, boundary, strict=True), "--", color=INK, lw=1)
        axis.plot(*boundary, "o", color=GOOD, zorder=5)
        axis.text(boundary[0] - 0.1, 3.18, r"$\Gamma$", color=GOOD, fontsize=12)
    kernel, chord, edges, warp = axes
    kernel.plot([boundary[0] - 0.3, boundary[0] + 0.3], [3, 3], color=GOOD, lw=5, alpha=0.5, solid_capstyle="butt")
    for x in (boundary[0] + 0.18, 1.7, 2.7):
        hit = abs(x - boundary[0]) < 0.3
        kernel.plot([apex[0], x], [0, 3], color=GOOD if hit else INK, lw=1.2, alpha=1 if hit else 0.4)
    chord.plot([apex[0], 2.2], [0, 3], color=INK, lw=1, alpha=0.4)
    chord.annotate("", (0.4, 3.08), (3.1, 3.08), arrowprops={"arrowstyle": "<->", "color": GOOD})
    chord.text(1.55, 3.2, "all of $C$ is searched", color=GOOD, fontsize=10)
    edges.plot(*edge, "s", color=GOOD)
    edges.annotate("", boundary, edge, arrowprops={"arrowstyle": "->", "color": GOOD, "lw": 1.6})
    edges.annotate("", apex, edge, arrowprops={"arrowstyle": "->", "color": GOOD, "lw": 1.6})
    edges.text(edge[0] + 0.12, edge[1], "$x_B$", color=GOOD, fontsize=11)
    for x in np.linspace(boundary[0], 3.0, 7):
        length = 0.45 / (1 + 6 * (x - boundary[0]) ** 2)
        warp.annotate("", (x + length, 2.85), (x, 2.85), arrowprops={"arrowstyle": "->", "color": GOOD})
    warp.text(1.5, 2.45, "$v = v_\\partial$ at $\\Gamma$", color=GOOD, fontsize=10)
    figure.savefig(FOLDER / "estimators.png", dpi=80)


def draw_cow() -> None:
    """README's first picture, of those in a notebook: a photograph, the asset from there, and in another light."""
    notebook = json.loads((FOLDER.parent / "notebooks/photographs_to_asset.ipynb").read_text())
    found = [output["data"] for cell in notebook["cells"] for output in cell.get("outputs", ()) if "data" in output]
    first, *_, last = (Image.open(io.BytesIO(b64decode(data["image/png"]))) for data in found if "image/png" in data)
    pair = first.crop((0, 22, 264, 150))  # of three rows: photograph, rendering, difference; without titles
    last = last.crop((0, 22, last.width, last.height))
    pair = pair.resize((round(pair.width * last.height / pair.height), last.height), Image.Resampling.LANCZOS)
    canvas = Image.new("RGB", (pair.width + 8 + last.width, last.height), "white")
    canvas.paste(pair, (0, 0))
    canvas.paste(last, (pair.width + 8, 0))
    canvas.quantize(256).save(FOLDER / "cow.png", optimize=True)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    draw_cow()
    draw_estimators()
    draw_terms()
