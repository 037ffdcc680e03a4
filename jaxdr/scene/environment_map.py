"""Environment map: radiance from a panorama of all directions, looked up as by Mitsuba's `envmap`.

A direction d in the map's frame has u = atan2(d.x, -d.z) / 2π and v = acos(d.y) / π. Column i of W is centred at
u = (i + 1/2) / W; columns wrap around. Row j of H is at v = j / (H - 1); the first row is the pole +y. Look-ups are
bilinear.
"""

import math

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, Shaped
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_array
from jaxdr.geometry import vector
from jaxdr.geometry.vector import components, from_components, normalize, transform
from jaxdr.scene.color import magnitude
from jaxdr.scene.emitters import DirectionSampler, Environment
from jaxdr.scene.ranges import floats
from jaxdr.scene.sampling import linear, linear_number, number_in_rows, search_sorted_rows

FLOOR = 0.01  # added to the magnitude that directions are sampled by, relative to its mean
# Share of the mean of a cell in the density at its corners. A purely bilinear density would be very low at a black
# texel beside the sun. The derivative of a turning map is the slope of the look-up divided by the density, and that
# slope is large there.
BLEND = 0.5
COMPARABLE = 0.25  # within `extent` the density does not fall below this share of the highest in the cell


@checked
class EnvironmentMap(Environment):
    """Radiance `scale` x `radiance` [H, W, 3] (W / m^2 sr) from all directions, on a grid of longitude and latitude.

    `to_world` [4, 4] maps the map's frame to the world's. It is a rotation; it may also mirror or scale evenly, since
    only directions matter. Conventions are Mitsuba's: in the map's frame the top of the image is the direction +y, its
    middle column is +z, and -x is to the right of the middle. Directions are sampled in proportion to magnitude.

    Raises ValueError unless `radiance` is finite floats [H >= 3, W >= 2, 3], `scale` is one number, and `to_world` is a
    4 x 4 matrix that does not skew or scale unevenly.
    """

    radiance: Float[Array, "H W 3"]
    to_world: Float[Array, "4 4"]
    scale: Float[Array, ""]
    uniform = False

    def __init__(self, radiance: ArrayLike, to_world: ArrayLike | None = None, scale: ArrayLike = 1.0):
        self.radiance = as_array(floats(radiance, "EnvironmentMap: radiance"))
        self.to_world = as_array(np.eye(4) if to_world is None else to_world)
        self.scale = as_array(scale)
        shape = self.radiance.shape
        if len(shape) != 3 or shape[2] != 3 or shape[0] < 3 or shape[1] < 2:
            raise ValueError(f"EnvironmentMap: radiance must be [H >= 3, W >= 2, 3], got shape {list(shape)}")
        if self.to_world.shape != (4, 4):
            raise ValueError(f"EnvironmentMap: to_world must be a 4 x 4 matrix, got shape {self.to_world.shape}")
        if self.scale.shape != ():
            raise ValueError(f"EnvironmentMap: scale must be a number, got shape {self.scale.shape}")

    def check_together(self):
        if not isinstance(self.to_world, Tracer):
            turn = np.asarray(self.to_world, float)[:3, :3]
            gram = turn.T @ turn
            if not np.allclose(gram, gram[0, 0] * np.eye(3), atol=1e-3 * abs(gram[0, 0])) or not gram[0, 0] > 0:
                raise ValueError("EnvironmentMap: to_world must not skew or scale unevenly")

    def eval(self, direction):
        height, width, _ = self.radiance.shape
        local = _to_map(self.to_world[:3, :3], direction)
        _, theta, u = _angles(local)
        row, along_row = _cell(theta * ((height - 1) / math.pi), height - 1)
        first, second, along = _columns(u, width)
        table = self.radiance.reshape(-1, 3)
        top, bottom = row * width, (row + 1) * width
        upper = vector.scale(table[top + first], 1 - along) + vector.scale(table[top + second], along)
        lower = vector.scale(table[bottom + first], 1 - along) + vector.scale(table[bottom + second], along)
        return self.scale * (vector.scale(upper, 1 - along_row) + vector.scale(lower, along_row))

    def sampler(self):
        radiance, scale = stop_gradient((self.radiance, self.scale))
        return LatLongSampler.of(magnitude(radiance), self.to_world[:3, :3], scale)

    def turn(self):
        rotation = _rotation(self.to_world[:3, :3])
        turned = rotation @ stop_gradient(rotation).T
        # The derivative of a rotation is antisymmetric. Any other change of the matrix is left to the look-up in a
        # fixed direction.
        turned = 0.5 * (turned - turned.T)
        return jnp.eye(3, dtype=turned.dtype) + (turned - stop_gradient(turned))


class LatLongSampler(DirectionSampler):
    """Density per solid angle that is bilinear in longitude and the cosine of the polar angle, in every cell of a map.

    Cells lie between the texels.

    - `corners`: unnormalised density at the texels, before it is blended (`BLEND`); `integral`: the same over the
      sphere.
    - `rows`: cumulative probabilities of the bands of cells; `columns`: those of the cells within each band.
    - `extents`: an angle around every cell within which the density stays above a quarter of the highest in the cell.
      It is half a texel where no larger angle is known to do so.
    - `reaches`: for every cell the largest extent of the cells whose extents contain it.
    """

    corners: Float[Array, "H W"]
    integral: Float[Array, ""]
    rows: Float[Array, " R"]
    columns: Float[Array, "R W"]
    extents: Float[Array, "R W"]
    reaches: Float[Array, "R W"]
    to_world: Float[Array, "3 3"]
    scale: Float[Array, ""]

    @classmethod
    def of(cls, magnitudes: Float[Array, "H W"], to_world: Float[Array, "3 3"], scale) -> "LatLongSampler":
        """The sampler in proportion to magnitude, but never zero: texels that are black now have a derivative too."""
        height, width = magnitudes.shape
        floor = FLOOR * magnitudes.mean()
        corners = magnitudes + jnp.where(floor > 0, floor, 1.0)
        angle = _band_angles(height, width, corners.dtype)
        right = jnp.roll(corners, -1, axis=1)
        cells = 0.25 * (corners + right)
        cells = (cells[:-1] + cells[1:]) * angle[:, None]
        extents, reaches = _extents(corners)
        columns = jnp.cumsum(cells, axis=1)
        bands = columns[:, -1]
        rows = jnp.cumsum(bands)
        return cls(
            corners=corners,
            integral=rows[-1],
            rows=rows / rows[-1],
            columns=columns / bands[:, None],
            extents=extents,
            reaches=reaches,
            to_world=_rotation(to_world),
            scale=scale,
        )

    def sample(self, u):
        height, width = self.corners.shape
        first, second = components(u)
        row, rest_row = search_sorted_rows(self.rows[None], jnp.zeros(u.shape[:-1], jnp.int32), second)
        column, rest_column = search_sorted_rows(self.columns, row, first)
        (a, b), (c, d) = self._at(row, column, (column + 1) % width)
        down = linear(rest_row, a + b, c + d)
        along = linear(rest_column, a + down * (c - a), b + down * (d - b))
        edges = jnp.asarray(_band_edges(height), u.dtype)
        cosine = jnp.clip((1 - down) * edges[row] + down * edges[row + 1], -1.0, 1.0)
        sine = jnp.sqrt((1.0 - cosine) * (1.0 + cosine))
        longitude = (column + 0.5 + along) * (2 * math.pi / width)
        local = from_components(sine * jnp.sin(longitude), cosine, -sine * jnp.cos(longitude))
        return stop_gradient(normalize(transform(self.to_world, local)))

    def numbers(self, direction):
        height, width = self.corners.shape
        cosine, theta, u = _angles(_to_map(self.to_world, stop_gradient(direction)))
        row, _ = _cell(theta * ((height - 1) / math.pi), height - 1)
        column, _, along = _columns(u, width)
        edges = jnp.asarray(_band_edges(height), cosine.dtype)
        down = jnp.clip((edges[row] - cosine) / (edges[row] - edges[row + 1]), 0.0, 1.0)
        (a, b), (c, d) = self._at(row, column, (column + 1) % width)
        rest_row = linear_number(down, a + b, c + d)
        rest_column = linear_number(along, a + down * (c - a), b + down * (d - b))
        return from_components(
            number_in_rows(self.columns, row, column, rest_column),
            number_in_rows(self.rows[None], jnp.zeros_like(row), row, rest_row),
        )

    def pdf(self, direction):
        height, width = self.corners.shape
        cosine, theta, u = _angles(_to_map(self.to_world, direction))
        row, _ = _cell(theta * ((height - 1) / math.pi), height - 1)
        first, second, along = _columns(u, width)
        edges = jnp.asarray(_band_edges(height), cosine.dtype)
        down = jnp.clip((edges[row] - cosine) / (edges[row] - edges[row + 1]), 0.0, 1.0)
        (a, b), (c, d) = self._at(row, first, second)
        value = (1 - down) * ((1 - along) * a + along * b) + down * ((1 - along) * c + along * d)
        return value / self.integral

    def extent(self, direction):
        return self.extents.reshape(-1)[self._cell_at(direction)]

    def reach(self, direction):
        return self.reaches.reshape(-1)[self._cell_at(direction)]

    def _cell_at(self, direction):
        height, width = self.corners.shape
        _, theta, u = _angles(stop_gradient(_to_map(self.to_world, direction)))
        row, _ = _cell(theta * ((height - 1) / math.pi), height - 1)
        return row * width + _columns(u, width)[0]

    def mean(self):
        return jnp.abs(self.scale) * self.integral / (4.0 * math.pi * (1.0 + FLOOR))

    def _at(self, row, first, second):
        """Corners of cells: ((upper left, upper right), (lower left, lower right))."""
        width = self.corners.shape[1]
        table = self.corners.reshape(-1)
        corners = [table[(row + k) * width + column] for k in (0, 1) for column in (first, second)]
        mean = BLEND * 0.25 * sum(corners)
        a, b, c, d = ((1.0 - BLEND) * corner + mean for corner in corners)
        return (a, b), (c, d)


def _rotation(matrix: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The matrix without its scale."""
    return matrix / jnp.sqrt((matrix[:, 0] ** 2).sum())


def _to_map(to_world: Float[Array, "3 3"], direction: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """World directions in the map's frame; not unit where the matrix scales."""
    return transform(to_world.T, direction)


def _angles(local: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"]]:
    """(cosine of the polar angle from +y, that angle, turns around +y from -z) of directions of any length.

    The derivative is zero at the poles. Zero vectors, in slots without a direction, count as +y.
    """
    x, y, z = components(local)
    on_axis = x * x + z * z == 0
    x, z = jnp.where(on_axis, 0.0, x), jnp.where(on_axis, -1.0, z)
    radius = jnp.where(on_axis, 0.0, jnp.sqrt(x * x + z * z))
    y = jnp.where(on_axis & (y == 0), 1.0, y)
    return y / jnp.sqrt(radius * radius + y * y), jnp.arctan2(radius, y), jnp.arctan2(x, -z) / (2 * math.pi)


def _cell(position, count: int) -> tuple[Int[Array, "*n"], Float[Array, "*n"]]:
    """(cell from 0 to count - 1, share of the way through it) of positions in [0, count]."""
    cell = jnp.clip(jnp.floor(stop_gradient(position)), 0, count - 1)
    return cell.astype(jnp.int32), position - cell


def _columns(u, width: int) -> tuple[Int[Array, "*n"], Int[Array, "*n"], Float[Array, "*n"]]:
    """(left column, right column, share of the way between them) at turns around the axis."""
    position = u * width - 0.5
    left = jnp.floor(stop_gradient(position))
    first = jnp.mod(left.astype(jnp.int32), width)
    return first, (first + 1) % width, position - left


def _band_edges(height: int) -> Float[np.ndarray, " H"]:
    """Cosines of the polar angles of the rows of texels, which bound the bands of cells."""
    return np.cos(np.pi * np.arange(height) / (height - 1))


def _band_angles(height: int, width: int, dtype) -> Float[Array, " R"]:
    """Solid angle of one cell of every band."""
    middle = np.pi * (np.arange(height - 1) + 0.5) / (height - 1)
    return jnp.asarray(2 * np.sin(middle) * np.sin(0.5 * np.pi / (height - 1)) * 2 * np.pi / width, dtype)


def _extents(corners: Float[Array, "H W"]) -> tuple[Float[Array, "R W"], Float[Array, "R W"]]:
    """(extents, reaches) of the cells, in radians; see `LatLongSampler`.

    Within the extent of a cell all corners are at least a quarter of the cell's highest corner. The reach of a cell is
    the largest extent of the cells whose extents contain it, or more.
    """
    height, width = corners.shape
    stacked = jnp.stack([corners[:-1], corners[1:]])
    stacked = jnp.concatenate([stacked, jnp.roll(stacked, -1, axis=2)])
    highest, lowest = stacked.max(0), stacked.min(0)
    step = np.pi / (height - 1)
    middle = (np.arange(height - 1) + 0.5) * step
    polar = np.minimum(middle, np.pi - middle)[:, None]
    # An angle that is certainly no larger than k cells. Columns are narrower towards the poles.
    extent, reach, k = jnp.full_like(lowest, 0.5) * _texel(polar, width, step), jnp.full_like(lowest, 0.5 * step), 1
    while 2 * k <= min(height - 1, width) // 2:
        lowest = -_grown(-lowest, max(k // 2, 1))  # the minimum over 1, 2, 4, ... cells to all sides
        wide = lowest >= COMPARABLE * highest
        extent = jnp.where(wide, k * _texel(polar - k * step, width, step), extent)
        around = wide
        for cells in _doubling(k + 1):
            around = _grown(around, cells)
        reach = jnp.where(around, k * step, reach)
        k *= 2
    return extent, reach


def _doubling(count: int):
    """Numbers that add up to `count`. Each exceeds the sum of those before it by at most one."""
    total = 0
    while total < count:
        cells = min(total + 1, count - total)
        total += cells
        yield cells


def _texel(polar, width: int, step: float):
    """Smaller side of a cell (radians) whose centre is at the angle `polar` from the nearer pole."""
    return np.minimum(step, 2 * np.pi / width * np.sin(np.maximum(polar, 0.5 * step)))


def _grown(table: Shaped[Array, "R W"], cells: int) -> Shaped[Array, "R W"]:
    """A table of maxima over neighbourhoods that are larger by `cells` rows and columns to all sides.

    The entries of `table` are maxima over their neighbourhoods. Nothing is left out if those go at least `cells` - 1
    rows and columns to all sides. Columns wrap around.
    """
    down = jnp.pad(table, ((cells, cells), (0, 0)), mode="edge")
    table = jnp.maximum(jnp.maximum(down[: -2 * cells], down[2 * cells :]), table)
    return jnp.maximum(jnp.maximum(jnp.roll(table, cells, axis=1), jnp.roll(table, -cells, axis=1)), table)
