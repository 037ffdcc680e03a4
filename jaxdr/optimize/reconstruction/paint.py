"""Where albedo and light start: the colours that photographs show, and the light that explains their shading."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.queries import Geometry, Rays, occluded
from jaxdr.optimize.reconstruction.atlas import Texels, covered, filled, interpolated
from jaxdr.optimize.reconstruction.pictures import Cut, Photographs
from jaxdr.optimize.reconstruction.sky import TO_WORLD, Backdrop, columns_of, directions, solid_angles

FAR = 1e30  # of rays without an end
LIFT = 1e-3  # of the longest side: visibility is asked for from so far above the surface
GREY = 0.3  # mean albedo to start with, a common one; the light takes the rest
DARKEST, BRIGHTEST = 0.03, 0.9  # albedo to start with
ROWS = 9  # of the light that is solved for: shading of dull surfaces tells no more
BLOCK = 1 << 17  # points at once: of many texels and photographs colours take 400 MB
DETAIL = 3.0  # most by which the paint that finer points show changes the albedo
SMOOTH, ROUNDS = 0.03, 4  # weight of differences of neighbouring directions; rounds of reweighting


def seen_colors(mesh: Mesh, photographs: Photographs, texels: Texels | None = None) -> Float[np.ndarray, "P 3"]:
    """Median colour of every vertex, or of `texels`, over the photographs that see it; of what none sees, that of the
    rest.

    Highlights are in few of them, so the median is the dull part.
    """
    points, normals = np.asarray(mesh.vertices, float), np.asarray(mesh.vertex_normals(), float)
    if texels is not None:
        points, normals = (interpolated(mesh, texels, values) for values in (points, normals))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    starts = range(0, len(points), BLOCK)
    blocks = [(points[i : i + BLOCK], normals[i : i + BLOCK]) for i in starts]
    colors = np.concatenate([_medians(mesh, *block, photographs) for block in blocks])
    known = np.isfinite(colors[:, 0])
    colors[~known] = np.median(colors[known], axis=0) if known.any() else GREY
    return colors


def _medians(
    mesh: Mesh, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], photographs: Photographs
) -> Float[np.ndarray, "n 3"]:
    """Median colour of points on the surface over the photographs that see them; NaN where none does."""
    seen = shown_colors(mesh, points, normals, photographs)
    seen.sort(axis=0)  # NaN last; `nanmedian` takes ten times the memory, and longer
    count = np.isfinite(seen[..., 0]).sum(0)
    below, above = (np.maximum(middle, 0)[None, :, None] for middle in ((count - 1) // 2, count // 2))
    above = np.minimum(above, len(seen) - 1)
    return 0.5 * (np.take_along_axis(seen, below, 0) + np.take_along_axis(seen, above, 0))[0].astype(float)


def shown_colors(
    mesh: Mesh, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], photographs: Photographs
) -> Float[np.ndarray, "N n 3"]:
    """Colours that photographs show of points on the surface; NaN where one does not show a point."""
    seen = np.full((len(photographs), len(points), 3), np.nan, np.float32)
    for cut, shown in zip(photographs, seen, strict=True):
        height, width, _ = cut.color.shape
        to_world = np.asarray(cut.camera.to_world, float)
        away = to_world[:3, 3] - points
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        facing = np.einsum("ni,ni->n", away, normals) > 0.3
        free = np.flatnonzero(facing & ~_hidden(mesh, points, normals, away, facing))
        column, row = np.floor(_projected(points[free], cut, width, height)).astype(int)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        free, column, row = free[inside], column[inside], row[inside]
        known = cut.trust if cut.alpha is None else np.minimum(cut.alpha, cut.trust)
        whole = known[row, column] > 0.99
        free, column, row = free[whole], column[whole], row[whole]
        shown[free] = cut.color[row, column]
    return seen


def detailed(
    albedo: Float[np.ndarray, "P 3"], seen: Float[np.ndarray, "P 3"], blurred: Float[np.ndarray, "P 3"]
) -> Float[np.ndarray, "P 3"]:
    """The albedo times what photographs show of points, relative to what coarser points could hold of that."""
    seen, blurred = (np.maximum(colors, DARKEST) for colors in (seen, blurred))
    return np.clip(albedo * np.clip(seen / blurred, 1 / DETAIL, DETAIL), DARKEST, BRIGHTEST)


def painted(
    mesh: Mesh, albedo: Float[np.ndarray, "V 3"], seen: Float[np.ndarray, "V 3"], photographs: Photographs, size: int
) -> Float[np.ndarray, "size size 3"]:
    """The albedo at vertices as a texture with the detail that photographs show between them; `seen`: `seen_colors`."""
    texels = covered(mesh, size)
    at_texels, blurred = (interpolated(mesh, texels, each) for each in (albedo, seen))
    return filled(texels, detailed(at_texels, seen_colors(mesh, photographs, texels), blurred), size)


def first_light_and_albedo(
    mesh: Mesh, colors: Float[np.ndarray, "V 3"], backdrop: Backdrop | None
) -> tuple[Float[np.ndarray, "H W 3"], Float[np.ndarray, "V 3"]]:
    """(radiance of a grey sky of 9 rows, albedo at the vertices) that explain dull colours of a surface together.

    The light is that under which a surface of one grey would look most like them, by least squares with no negative
    light and with outliers reweighted: light explains what it can, paint the rest. A `backdrop` of 9 rows is what is
    known of it, up to a factor. The albedo is what is left, of a mean of 0.3 where nothing else is known.
    """
    from scipy.optimize import nnls

    shading = _shading(mesh)
    brightness = colors.mean(1)
    rows, columns = ROWS, columns_of(ROWS)
    differences = SMOOTH * np.sqrt(len(colors)) * GREY * _differences(rows, columns)
    weight = np.ones(len(colors))
    light = np.zeros(rows * columns)
    for _ in range(ROUNDS):
        matrix = np.concatenate([weight[:, None] * GREY * shading, differences])
        light, _ = nnls(matrix, np.concatenate([weight * brightness, np.zeros(len(differences))]), maxiter=10_000)
        error = np.abs(GREY * shading @ light - brightness)
        weight = 1 / np.sqrt(np.maximum(error, max(0.5 * float(np.median(error)), 1e-6)))
        weight /= weight.mean()
    radiance = np.repeat(light.reshape(rows, columns, 1), 3, axis=2)
    if backdrop is not None:
        known = backdrop.weight[..., None]
        radiance = (1 - known) * radiance + known * np.maximum(
            backdrop.radiance, radiance * backdrop.clipped[..., None]
        )
    lit = shading @ radiance.reshape(-1, 3)
    albedo = colors / np.maximum(lit, 0.1 * lit.mean())
    return radiance, np.clip(albedo, DARKEST, BRIGHTEST)


def _shading(mesh: Mesh) -> Float[np.ndarray, "V T"]:
    """Radiance that a white dull surface reflects at every vertex, for a unit of light of every texel of the sky."""
    points, normals = np.asarray(mesh.vertices, float), np.asarray(mesh.vertex_normals(), float)
    towards = directions(ROWS).reshape(-1, 3) @ TO_WORLD[:3, :3].T
    angles = 4 * np.pi * np.broadcast_to(solid_angles(ROWS), (ROWS, columns_of(ROWS))).ravel()
    cosine = np.maximum(normals @ towards.T, 0.0)
    away = np.broadcast_to(towards, (len(points), *towards.shape))
    each_point, each_normal = (np.repeat(values, len(towards), 0) for values in (points, normals))
    hidden = _hidden(mesh, each_point, each_normal, away.reshape(-1, 3), cosine.ravel() > 0)
    return np.where(hidden.reshape(cosine.shape), 0.0, cosine) * angles / np.pi


def _differences(rows: int, columns: int) -> Float[np.ndarray, "D T"]:
    """Differences of neighbouring texels."""
    number = np.arange(rows * columns).reshape(rows, columns)
    pairs = [(number, np.roll(number, -1, axis=1)), (number[:-1], number[1:])]
    one, other = (np.concatenate([pair[i].ravel() for pair in pairs]) for i in (0, 1))
    matrix = np.zeros((len(one), rows * columns))
    matrix[np.arange(len(one)), one] += 1
    matrix[np.arange(len(one)), other] -= 1
    return matrix / np.sqrt(len(one))


def _hidden(
    mesh: Mesh,
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    away: Float[np.ndarray, "n 3"],
    asked: Bool[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    """Whether the surface hides what lies away from points on it, in unit directions; False where not `asked`.

    All points are passed, and not those that are asked about: JAX would compile anew for every number of points.
    """
    rays = Rays(*(jnp.asarray(a, jnp.float32) for a in (points + LIFT * normals, away, np.where(asked, FAR, 0.0))))
    return np.asarray(occluded(Geometry(mesh.vertices, mesh.faces), rays))


def _projected(points: Float[np.ndarray, "n 3"], cut: Cut, width: int, height: int) -> Float[np.ndarray, "2 n"]:
    """Film points (pixels) on the host: JAX would compile anew for every number of points."""
    to_world, fov, axis = (np.asarray(x, float) for x in cut.camera)
    left, up, depth = ((points - to_world[:3, 3]) @ to_world[:3, :3]).T
    focal = 0.5 * width / np.tan(np.radians(fov) / 2)
    return np.stack([(0.5 - axis[0]) * width - focal * left / depth, (0.5 - axis[1]) * height - focal * up / depth])
