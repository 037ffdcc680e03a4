"""The reference scenes with a moving mesh, and derivative images of them."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SCENES = (
    "direct_spot",
    "shadow_goathead",
    "cube_constant",
    "cornell_indirect",
    "mirror_spot",
    "environment_penguin",
)


@dataclass(frozen=True)
class Reference:
    """A scene, how it moves (`vertices` [V, 3] and their velocity `direction`), and its derivative image."""

    scene: object  # jd.Scene
    max_depth: int
    parameter: str
    shape: str
    vertices: object  # jax arrays
    direction: object
    image: np.ndarray  # [H, W, 3], float64
    noise: float  # root mean square of the image's own noise
    motion: dict  # the parameter's entry in oracle.json

    def derivative(self, integrator, spp: int):
        """A compiled function of a key: the derivative image."""
        import jax

        import jaxdr as jd

        @jd.jit
        def derivative(key):
            def image(v):
                return jd.render(self.scene.replace({f"{self.shape}.vertices": v}), key, spp, integrator)

            return jax.jvp(image, (self.vertices,), (self.direction,))[1]

        return derivative


def load(folder: Path, parameter: str = "") -> Reference:
    """The scene in a folder and its `parameter`, by name (default: the first rigid motion)."""
    import jaxdr as jd

    scene = jd.load_mitsuba(str(folder / "scene.xml"))
    oracle = json.loads((folder / "oracle.json").read_text())
    rigid = [p for p in oracle["parameters"] if p["kind"] in ("translate", "rotate")]
    chosen = next(p for p in rigid if parameter in ("", p["name"]))
    vertices = scene.parameters()[f"{chosen['shape']}.vertices"]
    direction = velocity(chosen, vertices)
    image = np.load(folder / chosen["file"]).astype(float)
    names = chosen["name"], chosen["shape"]
    return Reference(scene, oracle["max_depth"], *names, vertices, direction, image, chosen["noise_rms"], chosen)


def velocity(parameter: dict, vertices):
    """d vertices / d parameter of a rigid motion described in the scene's oracle.json: of any vertices [V, 3]."""
    import jax.numpy as jnp

    points = np.asarray(vertices, float)
    if parameter["kind"] == "translate":
        found = np.broadcast_to(np.array(parameter["direction"], float), points.shape)
    else:
        found = np.cross(np.array(parameter["axis"], float), points - np.array(parameter["pivot"], float))
    return jnp.asarray(found, vertices.dtype)
