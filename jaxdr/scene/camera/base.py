"""The interface of a camera, and the checks that constructors of cameras share."""

import abc

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked, shape_of
from jaxdr.arrays import as_array, numpy_for, traced
from jaxdr.scene.camera.view import View
from jaxdr.scene.film import Film
from jaxdr.scene.ranges import Parametric

NEAR_CLIP, FAR_CLIP = 1e-2, 1e4  # depths, as in Mitsuba; nothing is expected to be cut there


class Camera(Parametric, eqx.Module):
    """A camera maps film points (pixels) to rays, and world points back to film points.

    Its float fields are parameters of the scene, such as `camera.to_world` [4, 4] (camera to world). It sees what lies
    at depths from `near_clip` to `far_clip`, in units of its frame along its axis.

    A camera without an `aperture` is one `View`. A camera with one has a view for every point of its lens, and each
    sample sees through its own lens point.
    """

    to_world: eqx.AbstractVar[Float[Array, "4 4"]]
    film: eqx.AbstractVar[Film]
    near_clip: eqx.AbstractVar[float]
    far_clip: eqx.AbstractVar[float]
    aperture: eqx.AbstractClassVar[bool]

    @abc.abstractmethod
    def view(self, u: Float[Array, "n 2"] | None = None) -> View:
        """The view from the centre of the aperture, or the views from lens points drawn by uniform numbers `u`."""

    def blur(self, local: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """How far (pixels) points in the frame move on the film as the lens point goes from the centre to the rim.

        It is positive for points closer than the plane of focus, and negative for points beyond it. For lens points in
        between they move in proportion.
        """
        raise NotImplementedError(f"{type(self).__name__} has no aperture")

    def turns(self, points: Float[Array, "*n 3"], normal: Float[Array, "*n 3"]) -> Bool[Array, "*n"]:
        """Whether some lens points see the front, and others the back, of surfaces with these normals."""
        raise NotImplementedError(f"{type(self).__name__} has no aperture")

    def rays(self, film_points: Float[Array, "*n 2"]) -> tuple[Float[Array, "*#n 3"], Float[Array, "*n 3"]]:
        """Origins and unit directions [..., 3] of the rays through film points; a pinhole has one origin [3]."""
        return self.view().rays(film_points)

    def local(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """World points in the camera's frame (left, up, forward)."""
        return self.view().local(points)

    def project(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Film points of world points (in front of the camera)."""
        return self.view().project(points)

    def project_local(self, local: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Film points of points in the camera's frame with positive depth."""
        return self.view().project_local(local)


@checked
def look_at(origin: ArrayLike, target: ArrayLike, up: ArrayLike) -> Float[np.ndarray | Array, "4 4"]:
    """Camera-to-world matrix that looks from `origin` to `target`. Columns are left, up, forward, origin (Mitsuba's).

    Traceable and differentiable; for concrete vectors it is a NumPy array. Raises ValueError for other shapes, numbers
    that are not finite, if origin and target coincide, or if `up` is parallel to the line between them. For traced
    vectors of such values the matrix is NaN.
    """
    for name, vector in (("origin", origin), ("target", target), ("up", up)):
        if shape_of(vector) != (3,):
            raise ValueError(f"look_at: {name} must be three numbers, got shape {shape_of(vector)}")
        if not traced(vector) and not np.isfinite(np.asarray(vector, float)).all():
            raise ValueError(f"look_at: {name} must be finite, got {np.asarray(vector).tolist()}")
    xp = numpy_for(origin, target, up)
    position, point, above = (xp.asarray(v, float) for v in (origin, target, up))
    forward = point - position
    left = xp.cross(above, forward)
    if xp is np and not np.linalg.norm(left) > 1e-12 * max(np.linalg.norm(above) * np.linalg.norm(forward), 1e-300):
        raise ValueError(f"look_at: up {above} is parallel to the view direction {forward}, or one of them is zero")
    forward, left = forward / xp.linalg.norm(forward), left / xp.linalg.norm(left)
    axes = xp.stack([left, xp.cross(forward, left), forward, position], axis=1)
    return xp.concatenate([axes, xp.asarray([[0.0, 0.0, 0.0, 1.0]], axes.dtype)])


def concrete(value: object) -> np.ndarray | None:
    """The value on the host; None for a traced value."""
    return None if traced(value) else np.asarray(value)


def checked_pose(name: str, to_world, scales: bool) -> Float[Array, "4 4"]:
    """`to_world` as an array. Raises ValueError unless it is an affine 4 x 4 matrix that can be inverted.

    Without `scales` all axes must be orthogonal and have the same length. Only the shape of a traced matrix is checked.
    """
    matrix = as_array(to_world)
    if matrix.shape != (4, 4):
        raise ValueError(f"{name}: to_world must be a 4 x 4 matrix, got shape {matrix.shape}")
    values = concrete(to_world)
    if values is None:
        return matrix
    axes = values[:3, :3].astype(float)
    if not (np.isfinite(values).all() and np.allclose(values[3], [0, 0, 0, 1])):
        raise ValueError(f"{name}: to_world must be finite with a last row 0 0 0 1, got {values.tolist()}")
    lengths = np.linalg.norm(axes, axis=0)
    if not np.abs(np.linalg.det(axes)) > 1e-6 * np.prod(lengths):
        raise ValueError(f"{name}: to_world can't be inverted: its axes lie in a plane: {values.tolist()}")
    if not scales and not np.allclose(axes.T @ axes, lengths[2] ** 2 * np.eye(3), atol=1e-3 * lengths[2] ** 2):
        raise ValueError(
            f"{name}: to_world may rotate, translate and scale all axes alike, not shear; got {values.tolist()}"
        )
    return matrix


def checked_clip(name: str, near_clip: float, far_clip: float) -> tuple[float, float]:
    """Both planes as numbers. Raises ValueError unless 0 < near_clip < far_clip."""
    near, far = float(near_clip), float(far_clip)
    if not 0 < near < far:
        raise ValueError(f"{name}: need 0 < near_clip < far_clip, got {near_clip} and {far_clip}")
    return near, far
