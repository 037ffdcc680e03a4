"""Material or spherical form, and which distance function: small versions of Fig. 12, 13 and 18 of Xu et al. 2023.

    python -m experiments.warped_area.run star
    python -m experiments.warped_area.run chess
    python -m experiments.warped_area.run cube

Each writes its derivative images, curves and a table to `experiments/warped_area/results`.
"""

import csv
import tomllib
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax

import jaxdr as jd
from experiments import common
from experiments.warped_area import scenes
from jaxdr.optimize.recovery.config import recovery_config
from jaxdr.optimize.recovery.recover import recover
from jaxdr.optimize.recovery.scenes import star_light
from jaxdr.optimize.strict_toml import read_toml

STUDY = "warped_area"
HERE = Path(__file__).parent
COLUMNS = {
    "method": ("method", "s"),
    "samples": ("spp", "d"),
    "projection": ("projection", ".3f"),
    "±": ("uncertainty", ".3f"),
    "error / reference": ("error", ".2f"),
}


def estimators(settings: dict) -> dict:
    """The estimators by their names in the tables."""
    sigma0 = float(settings["sigma0"])
    return {
        "WarpedArea": jd.WarpedArea(sigma0=sigma0),
        "WarpedArea, exponential": jd.WarpedArea("exponential"),
        "RednerWAS, path space": jd.RednerWAS("path_space", sigma0=sigma0),
        "RednerWAS": jd.RednerWAS(),
        "RednerWAS, path space, no normal edges": jd.RednerWAS("path_space", False, sigma0),
        "RednerWAS, no normal edges": jd.RednerWAS(normal_edges=False),
    }


@partial(jd.jit, static_argnames=("name", "boundary", "spp"))
def derivative(of: jd.Scene, name: str, direction, key, boundary, spp: int):
    """Derivative image [H, W], channels averaged, by a translation of the vertices `name`."""
    vertices = of.parameters()[name]

    def image(shift):
        integrator = jd.PathTracer(2, boundary, sampling="emitter")
        return jd.render(of.replace({name: vertices + shift * direction}), key, spp, integrator).mean(-1)

    return jax.jvp(image, (0.0,), (1.0,))[1]


def compare(of: jd.Scene, name: str, direction, methods: dict, settings: dict):
    """({method: one image}, rows of the table): `keys` images each, against many samples of `LineSampling`."""
    direction, spp = jnp.asarray(direction, float), settings["spp"]
    keys = jax.random.split(jax.random.key(settings["seed"]), settings["keys"])
    lines = [derivative(of, name, direction, key, jd.LineSampling(), settings["reference_spp"]) for key in keys]
    truth = np.mean(jax.device_get(lines), 0)
    images, rows = {"LineSampling (reference)": truth}, []
    for method, boundary in methods.items():
        found = np.stack([jax.device_get(derivative(of, name, direction, key, boundary, spp)) for key in keys])
        along = (found * truth).sum((1, 2)) / (truth**2).sum()
        rows.append(
            {
                "method": method,
                "spp": spp,
                "projection": float(along.mean()),
                "uncertainty": float(along.std(ddof=1) / len(along) ** 0.5),
                "error": float(np.sqrt(((found - truth) ** 2).mean() / (truth**2).mean())),
            }
        )
        print(rows[-1], flush=True)
        images[method] = found[0]
    return images, rows


def star(settings: dict, folder: Path):
    """Fig. 12: the light's displacement, and its pose from an image."""
    methods = _chosen(settings)
    images, rows = compare(
        star_light(resolution=settings["resolution"]), "light.vertices", [1, 0, 0], methods, settings
    )
    write(folder, "star", images, rows, COLUMNS)
    curves = {}
    for method, boundary in methods.items():
        summary, points = _recovered(method, boundary, settings)
        curves[method] = points
        rows[list(methods).index(method)] |= {
            "start": summary["errors"]["light.vertices distance"][0],
            "end": summary["errors"]["light.vertices distance"][1],
        }
    columns = COLUMNS | {"distance at start": ("start", ".3f"), "at the end": ("end", ".3f")}
    write(folder, "star", images, rows, columns, curves, "distance of the light's vertices")


def _recovered(method: str, boundary, settings: dict):
    """The run of configs/star_light.toml with another estimator: (its summary, distances by iteration)."""
    folder = common.scratch(STUDY) / method.replace(", ", "_").replace(" ", "_")
    kind, fields = type(boundary).__name__, ("distance", "sigma0", "normal_edges")
    chosen = {name: getattr(boundary, name) for name in fields if hasattr(boundary, name)}
    options = ", ".join(f"{name} = {_toml(value)}" for name, value in chosen.items())
    overrides = [
        f"output={folder}",
        f"integrator.boundary={kind}",
        f"integrator.boundary_options={{ {options} }}",
        f"optimizer.iterations={settings['iterations']}",
        f"samples.gradient={settings['gradient']}",
        f"scene.options.resolution={settings['resolution']}",
    ]
    path = common.ROOT / "configs/star_light.toml"
    summary = recover(recovery_config(read_toml(path, overrides), path), overwrite=True)
    with open(folder / "metrics.csv") as file:
        found = [float(row["light.vertices distance"]) for row in csv.DictReader(file)]
    return summary, [summary["errors"]["light.vertices distance"][0], *found]


def _toml(value) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower()


def chess(settings: dict, folder: Path):
    """Fig. 13: the shadow of a piece, its displacement and its shape."""
    methods, piece = _chosen(settings), scenes.chess_piece()
    turns = scenes.poses(settings["poses"])
    of = scenes.chess(piece, settings["resolution"])
    shown = of.replace({"piece.vertices": _placed(piece.vertices, turns[0])})
    images, rows = compare(shown, "piece.vertices", [1, 0, 0], methods, settings)
    write(folder, "chess", images, rows, COLUMNS)
    targets = []
    for k, turn in enumerate(turns):
        posed = of.replace({"piece.vertices": _placed(piece.vertices, turn)})
        targets.append(jd.render(posed, jax.random.key(k), 256, jd.PathTracer(2)))
    curves = {}
    for row, (method, boundary) in zip(rows, methods.items(), strict=True):
        curves[method] = _shaped(boundary, settings, piece, turns, jnp.stack(targets))
        row |= {"start": curves[method][0], "end": curves[method][-1]}
        print(method, curves[method][0], curves[method][-1], flush=True)
    columns = COLUMNS | {"chamfer at start": ("start", ".4f"), "at the end": ("end", ".4f")}
    write(folder, "chess", images, rows, columns, curves, "Chamfer distance")


def _placed(vertices, turn):
    return vertices @ jnp.asarray(turn, float).T + jnp.asarray([0.0, 0.0, scenes.HEIGHT])


def _shaped(boundary, settings: dict, piece: jd.Mesh, turns, targets) -> list[float]:
    """Chamfer distance every few iterations, of a shape that starts as an ellipsoid."""
    ball = jd.shapes.sphere(settings["subdivisions"], 0.5)
    start = jd.Mesh(np.asarray(ball.vertices) * [0.5, 0.5, 0.95], ball.faces)
    of, steps = scenes.chess(start, settings["resolution"]), jd.LargeSteps(start, settings["smoothing"])
    integrator = jd.PathTracer(2, boundary, sampling="emitter")

    @jd.jit
    def gradient(of, latent, turn, target, key):
        def loss(latent):
            placed = _placed(steps.from_latent(latent), turn)
            image = jd.render(of.replace({"piece.vertices": placed}), key, settings["step_spp"], integrator)
            return ((image - target) ** 2).mean()

        return jax.grad(loss)(latent)

    latent = steps.to_latent(start.vertices)
    rate = optax.exponential_decay(settings["rate"], settings["iterations"], 0.2)
    optimizer = jd.adam_uniform(rate)
    state, found = optimizer.init(latent), []
    key = jax.random.key(settings["seed"])
    for i in range(settings["iterations"] + 1):
        if i % settings["every"] == 0:
            found.append(jd.chamfer(start.with_vertices(steps.from_latent(latent)), piece, 5000))
        pose, key_step = i % len(turns), jax.random.fold_in(key, i)
        slope = gradient(of, latent, jnp.asarray(turns[pose], float), targets[pose], key_step)
        update, state = optimizer.update(slope, state)
        latent = latent + jnp.asarray(update)
    return found


def cube(settings: dict, folder: Path):
    """Fig. 18: a cube-shaped light is displaced."""
    images, rows = compare(
        scenes.cube_light(settings["resolution"]), "light.vertices", [1, 0, 0], _chosen(settings), settings
    )
    write(folder, "cube", images, rows, COLUMNS)


def _chosen(settings: dict) -> dict:
    known = estimators(settings)
    return {name: known[name] for name in settings["methods"]}


def write(folder: Path, name: str, images: dict, rows: list, columns: dict, curves=None, label=""):
    """`name`.png, its table and its numbers."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    common.write_json(folder / f"{name}.json", {"rows": rows, "curves": curves})
    table = common.table(rows, columns)
    (folder / f"{name}.md").write_text(table + "\n")
    print(table)
    wide = len(images) + bool(curves)
    figure, panels = plt.subplots(1, wide, figsize=(2.3 * wide + 0.8 * bool(curves), 2.5))
    limit = np.quantile(np.abs(next(iter(images.values()))), 0.995)
    for panel, (title, image) in zip(panels, images.items(), strict=False):
        panel.imshow(image, cmap="seismic", vmin=-limit, vmax=limit)
        panel.set_title(title.replace(", ", ",\n"), fontsize=7)
        panel.axis("off")
    if curves:
        for method, points in curves.items():
            panels[-1].semilogy(np.linspace(0, 1, len(points)), points, label=method, lw=1)
        panels[-1].set_title(label, fontsize=7)
        panels[-1].set_xlabel("share of the iterations", fontsize=7)
        panels[-1].tick_params(labelsize=6)
        panels[-1].legend(fontsize=5)
    figure.tight_layout()
    figure.savefig(folder / f"{name}.png", dpi=110)
    plt.close(figure)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("figure", choices=("star", "chess", "cube"))
    options = parser.parse_args()
    settings = tomllib.loads((HERE / f"{options.figure}.toml").read_text())
    if options.quick:
        settings |= {"keys": 2, "reference_spp": 16, "resolution": 16}
        settings |= {"iterations": 4, "poses": 2, "every": 2}
    {"star": star, "chess": chess, "cube": cube}[options.figure](settings, common.results(STUDY, options.quick))


if __name__ == "__main__":
    main()
