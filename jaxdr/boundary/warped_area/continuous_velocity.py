"""Continuous velocity of a warped area: a convolution of discontinuous velocities, and its divergence.

Xu et al. 2023, "Warped-Area Reparameterization of Differential Path Integrals", Eq. 14-18 and 41-47, 58-62. For a fixed
apex y and a target p, auxiliary points q around p have velocities v_i: zero where y sees q, else that of the occluder
projected to q. The continuous velocity is their weighted mean v(p) = sum_i share_i(p) v_i. Shares and their gradients
are detached and do not depend on the v_i. So nothing here is differentiated with respect to the scene.
"""

import math
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.geometry import queries
from jaxdr.geometry.vector import components, dot, interpolate, norm, normalize, orthonormal_basis, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import detached_barycentric
from jaxdr.transport.sampler import uniform

TAIL = 3.0  # the density of auxiliary points falls as |q - p|^(-2 TAIL), as the kernel does for a power of 3
DEPTH = 10.0  # projections count up to so many kernel widths from the tangent plane; there the kernel is 1e-6


class Kernel(NamedTuple):
    """The kernel w(q; p) = 1 / (D(q; p) + B(q)^boundary_power) (Eq. 15); all static.

    `sigma` is relative to the length of the segment (Eq. 17 in units of this length). `spread` is the spread of the
    auxiliary points relative to the kernel's width.
    """

    distance: Literal["path_space", "exponential"]
    sigma: float
    power: float
    boundary_power: float
    spread: float

    @property
    def width(self) -> float:
        """Width of the auxiliary points' density over the segment's length; "exponential" has no small scale."""
        return self.spread * (self.sigma if self.distance == "path_space" else 1.0)

    @property
    def depth(self) -> float:
        """Largest distance of projections from the tangent plane, relative to the length of the segment."""
        return DEPTH * self.sigma if self.distance == "path_space" else DEPTH

    def value(self, apex, point, position, boundary) -> Float[Array, "N Q C"]:
        """log w(q; p) at positions q [N, Q, C, 3] for points p [N, 3] (Eq. 16, or Eq. 57)."""
        apex, point = apex[:, None, None], point[:, None, None]
        if self.distance == "path_space":
            offset, length = position - point, point - apex
            share = dot(offset, offset) / dot(length, length)
            distance = (-jnp.expm1(-share / self.sigma) / self.sigma) ** self.power
        else:
            apart = normalize(position - apex) - normalize(point - apex)
            distance = jnp.expm1(0.5 * dot(apart, apart))  # 1 - cosine, without cancellation
        return -jnp.log(jnp.maximum(distance + boundary**self.boundary_power, 1e-30))


class Convolution(NamedTuple):
    """How velocities are convolved; static.

    - `samples`: auxiliary points for each target; `projections`: at most so many for each auxiliary point.
    - `debias`: as in `WarpedArea`.
    - `finite`, `infinite`: whether there are targets on surfaces, and targets infinitely far away.
    - `normal_edges`: see `find_occluders`.
    - `horizon`: whether the plane of the apex's own face may hide something.
    - `rays`: as in `PathTracer`.
    """

    kernel: Kernel
    samples: int
    projections: int
    debias: bool
    finite: bool
    infinite: bool
    normal_edges: bool = True
    horizon: bool = True
    rays: str = "auto"


class Auxiliary(NamedTuple):
    """Q points drawn around each of N targets, and up to C projections of each onto the target's shape.

    `drawn` points lie in the tangent plane, or at infinity on the sphere of directions. `slant` is |cos| between the
    normals of the tangent plane and of the projection's face. The density of a projection is that of its point times
    the slant (Eq. 46).
    """

    drawn: Float[Array, "N Q 3"]
    position: Float[Array, "N Q C 3"]
    face: Int[Array, "N Q C"]
    barycentric: Float[Array, "N Q C 3"]
    slant: Float[Array, "N Q C"]
    there: Bool[Array, "N Q C"]


class Field(NamedTuple):
    """v(p) = sum_i share_i v_i and its divergence sum_i divergence_i . v_i, for vectors v_i at auxiliary points."""

    share: Float[Array, "N Q C"]
    divergence: Float[Array, "N Q C 3"]


def draw_auxiliary(
    packed: PackedScene,
    normals: Float[Array, "F 3"],
    ends: SegmentEnds,
    active: Bool[Array, " N"],
    around: Convolution,
    key: PRNGKeyArray,
) -> Auxiliary:
    """Auxiliary points of detached targets, with their projections along the normal; none where not `active`.

    `normals` are the faces' unit normals.
    """
    kernel, samples, capacity = around.kernel, around.samples, around.projections
    n, dtype = ends.apex.shape[0], ends.apex.dtype
    length = norm(ends.target - ends.apex)
    u = uniform(key, (n, samples, 2), dtype)
    first, second = components(u)
    radius = jnp.sqrt(jnp.expm1(-jnp.log1p(-first) / (TAIL - 1.0))) * (kernel.width * length)[:, None]
    angle = 2.0 * math.pi * second
    s, t = orthonormal_basis(ends.normal)
    offset = scale(s[:, None], jnp.cos(angle)) + scale(t[:, None], jnp.sin(angle))
    drawn = ends.target[:, None] + scale(offset, radius)
    far = ends.infinite[:, None, None]
    if around.infinite:
        on_sphere = ends.apex[:, None] + scale(normalize(drawn - ends.apex[:, None]), length[:, None])
        drawn = jnp.where(far, on_sphere, drawn)
    if not around.finite:
        one = jnp.ones((n, samples, 1), dtype)
        there = jnp.broadcast_to(active[:, None, None], one.shape)
        nowhere, third = jnp.zeros(one.shape, jnp.int32), jnp.full((*one.shape, 3), 1 / 3, dtype)
        return Auxiliary(drawn, drawn[:, :, None], nowhere, third, one, there)

    flat = drawn.reshape(-1, 3)
    along = jnp.repeat(ends.normal, samples, axis=0)
    depth = jnp.where(active & ~ends.infinite, kernel.depth * length, 0.0)
    depth = jnp.minimum(depth, packed.size)
    depth, shape = (jnp.repeat(a, samples) for a in (depth, packed.face_shape[ends.face]))
    lines = queries.Lines(flat, along, depth, shape)
    found = queries.projections(packed.geometry, packed.face_shape, lines, capacity, around.rays)
    there = found.face >= 0
    face = jnp.where(there, found.face, 0).reshape(-1)
    origin, direction = jnp.repeat(flat, capacity, axis=0), jnp.repeat(along, capacity, axis=0)
    barycentric = detached_barycentric(packed, origin, direction, face)
    position = interpolate(packed.corners_of(face), barycentric)
    slant = jnp.abs(dot(normals[face], direction))
    full = (n, samples, capacity)
    there = there.reshape(full) & (slant.reshape(full) > 0)
    position, slant = position.reshape(*full, 3), slant.reshape(full)
    if around.infinite:
        position = jnp.where(far[..., None], drawn[:, :, None], position)
        slant = jnp.where(far, 1.0, slant)
        there = jnp.where(far, active[:, None, None] & (jnp.arange(capacity) == 0), there)
    return Auxiliary(drawn, position, face.reshape(full), barycentric.reshape(*full, 3), slant, there)


def log_density(kernel: Kernel, ends: SegmentEnds, drawn, point, infinite: bool) -> Float[Array, "N Q"]:
    """Log of the density of drawn points around `point`: per area of the tangent plane or, at infinity, the sphere."""
    away = point - ends.apex
    length = norm(away)
    normal, offset = ends.normal, drawn - point[:, None]
    if infinite:
        normal = jnp.where(ends.infinite[:, None], scale(away, 1.0 / length), normal)
    in_plane = offset - scale(normal[:, None], dot(offset, normal[:, None]))
    radius2, width = dot(in_plane, in_plane), (kernel.width * length)[:, None]
    bent = jnp.zeros_like(radius2)
    if infinite:  # an area of the tangent plane is 1 / cosine^3 times that on the sphere
        cosine = dot(normalize(drawn - ends.apex[:, None]), normal[:, None])
        cosine = jnp.where(ends.infinite[:, None], cosine, 1.0)
        radius2, bent = radius2 / cosine**2, -3.0 * jnp.log(cosine)
    inside = -2.0 * jnp.log(width) - TAIL * jnp.log1p(radius2 / width**2)
    return math.log((TAIL - 1.0) / math.pi) + inside + bent


def log_weights(
    kernel: Kernel, ends: SegmentEnds, points: Auxiliary, boundary: Float[Array, "N Q C"], point, infinite: bool
) -> Float[Array, "N Q C"]:
    """Log of w(q; p) over the density of q around the targets. The shares are the softmax of these logs."""
    density = log_density(kernel, ends, points.drawn, ends.target, infinite)[..., None]
    weight = kernel.value(ends.apex, point, points.position, boundary) - density
    slant = jnp.where(points.there, points.slant, 1.0)
    return jnp.where(points.there, weight - jnp.log(slant), -jnp.inf)


def shares_of(weights: Float[Array, "N Q C"]) -> Float[Array, "N Q C"]:
    """Weights normalised by their sum (Eq. 47), from their logs; zeros if a target has no auxiliary point."""
    largest = weights.max((1, 2), keepdims=True)
    # A target without points has -inf everywhere: exp(-inf - 0) is zero, exp(-inf + inf) would be NaN.
    raised = jnp.exp(weights - jnp.where(largest == -jnp.inf, 0.0, largest))
    total = raised.sum((1, 2), keepdims=True)
    return safe_divide(raised, total)


def velocity_field(
    kernel: Kernel,
    ends: SegmentEnds,
    points: Auxiliary,
    boundary: Float[Array, "N Q C"],
    debias: bool,
    infinite: bool,
) -> Field:
    """Shares of the auxiliary points, and the factors of their velocities in the divergence.

    The gradient of a share follows from the gradients of log w in two tangent directions, by forward mode with fixed q
    (Eq. 58-62). With `debias` the change of the density of q with p counts as well. Then the expected divergence is
    exactly that of the mean field E[v(p)], for any number of points. Without it this holds only in the limit of many
    points.
    """

    def logs(point):
        drawn = log_density(kernel, ends, points.drawn, point, infinite)
        return kernel.value(ends.apex, point, points.position, boundary), drawn

    share = shares_of(log_weights(kernel, ends, points, boundary, ends.target, infinite))
    of_point = share.sum(2)
    divergence = jnp.zeros((*share.shape, 3), share.dtype)
    for tangent in orthonormal_basis(ends.normal):
        _, (slope, score) = jax.jvp(logs, (ends.target,), (tangent,))
        slope = jnp.where(points.there, slope, 0.0)
        rate = slope - (share * slope).sum((1, 2), keepdims=True)
        if debias:
            rate = rate + _score_terms(of_point, score)[..., None]
        divergence += scale(tangent[:, None, None], share * rate)
    if infinite:  # the surface divergence on a sphere leaves out the mean's normal component
        curvature = jnp.where(ends.infinite, 2.0 / norm(ends.target - ends.apex), 0.0)
        divergence -= scale(scale(ends.normal, curvature)[:, None, None], share)
    return Field(share, divergence)


def _score_terms(share: Float[Array, "N Q"], score: Float[Array, "N Q"]) -> Float[Array, "N Q"]:
    """A_k s_k - sum_{i != k} A_i^2 s_i / (1 - A_i), with A the shares of the drawn points and s their scores.

    The divergence of E[v] has the terms s_i (v - v_without_i), since E[s_i v_without_i] = 0. The weights contain
    1 / density, which moves as well. Both together give s_i A_i^2 (v_i - v_without_i).
    """
    others = 1.0 - jnp.eye(share.shape[1], dtype=share.dtype)
    rest = (share[:, None] * others).sum(-1)  # 1 - A_i, without cancellation
    part = safe_divide(share**2 * score, rest, otherwise=0.0)
    return share * score - (part[:, None] * others).sum(-1)
