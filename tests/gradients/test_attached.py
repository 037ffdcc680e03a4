"""Attached lobes against exact numbers and against the material form: what a narrow lobe sees, and how it moves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.lax import stop_gradient

import jaxdr as jd
from jaxdr.boundary import attached_lines, chords, line_sampling
from jaxdr.boundary.attached_lines import AttachedLines
from jaxdr.geometry.queries import UNBOUNDED
from jaxdr.scene.packed import pack
from jaxdr.transport import path
from jaxdr.transport.interaction import material_point
from jaxdr.transport.shading import Scatterer
from tests.gradients.lobe_point import APART_FACES, CASES, ROOF, SLOPE, check, scene
from tests.gradients.phong import Phong

MATERIAL, ATTACHED = jd.LineSampling(), jd.LineSampling(attached=0.5)
# Without a pilot the program is smaller.
PLAIN = jd.LineSampling(pilot=0.0, attached=0.5)
# A depth of two is enough where nothing scatters but the mirror.
DEPTHS = {"sky": 2, "lamp": 2, "roof": 3, "eclipse": 2}


class OnSurface(Phong):
    """The directions keep to the surface's frame, and the lobe moves off them."""

    def turn(self, wi, wo):
        return wo


def test_a_lamp_in_the_lobe():
    """Both sampling techniques, the outline of the lamp, and every way to move it, the mirror or the camera."""
    check("lamp", PLAIN, alone=True, quick=True, keys=8)


@pytest.mark.slow
def test_a_lamp_behind_something():
    """Emitter samples that are occluded: what chords on the lamp find counts by their share of its light."""
    check("eclipse", PLAIN, alone=True, quick=True, keys=64, spp=128)


def test_directions_turn_rigidly_with_the_lobe():
    """Whatever moves: angles between directions stay, and so does the density of each. Their values are as drawn."""
    of = scene(alone=True)
    rng = np.random.default_rng(0)
    count = 64
    drawn = jnp.asarray(rng.normal(size=(2, count, 3)) * 0.2 + np.array([0.0, 0.7, 0.7]), jnp.float32)
    drawn = drawn / jnp.linalg.norm(drawn, axis=-1, keepdims=True)
    velocity = jnp.asarray(rng.normal(size=(4, 3)), jnp.float32)
    mirror = of.parameters()["mirror.vertices"]

    def moved(t):
        packed = pack(of.replace({"mirror.vertices": mirror + t * velocity}))
        face = jnp.full(count, packed.first_face[list(of.shapes).index("mirror")])
        point = material_point(packed, face, jnp.full((count, 3), 1 / 3), jnp.ones(count, bool))
        towards = jnp.asarray([0.1, -3.0, 2.6]) - point.position
        scatterer = Scatterer(packed, point, towards / jnp.linalg.norm(towards, axis=-1, keepdims=True))
        turned = jnp.stack([scatterer.turn(d) for d in drawn])
        return turned, (turned[0] * turned[1]).sum(-1), jnp.log(scatterer.density(turned[0]))

    values, rates = jax.jvp(moved, (jnp.float32(0.0),), (jnp.float32(1.0),))
    np.testing.assert_array_equal(values[0], drawn)
    assert np.abs(rates[0]).max() > 0.1
    np.testing.assert_allclose(rates[1], 0.0, atol=1e-5)
    np.testing.assert_allclose(rates[2], 0.0, atol=1e-3)  # the lobe's exponent is 44


@pytest.mark.slow
@pytest.mark.parametrize("boundary", [MATERIAL, ATTACHED], ids=["material", "attached"])
@pytest.mark.parametrize("case", CASES)
def test_every_derivative_is_the_closed_form(case, boundary):
    """A black roof before a sky, its two sides in the light of a lamp (with the crease between), a lamp."""
    check(case, boundary, depth=3, keys=32, spp=32)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Mesh")
@pytest.mark.parametrize("depth", [0.3, -0.3], ids=["ridge", "valley"])
def test_corners_between_shapes(depth):
    """The roof's sides as two sheets that touch: the jump between them counts once, whichever is in front."""
    apart = ROOF[[0, 1, 3, 4, 1, 2, 4, 5]] - np.array([0, 1, 0, 1, 1, 0, 1, 0])[:, None] * (depth - 0.3) * SLOPE
    check("roof", PLAIN, alone=True, depth=3, keys=48, spp=32, change={"roof": apart, "roof_faces": APART_FACES})


@pytest.mark.slow
def test_any_rotation_will_do():
    """Directions that follow the surface instead of the lobe: another share between the terms, the same derivative."""
    check("sky", PLAIN, alone=True, bsdf=OnSurface, keys=48, spp=32)


def without_creases(patch):
    patch.setattr(chords, "UNBOUNDED_FOLDS", UNBOUNDED)


def without_turning(patch):
    motion = AttachedLines._motion

    def edge_alone(*args):
        edge, lobe = motion(*args)
        return edge, stop_gradient(lobe)

    patch.setattr(AttachedLines, "_motion", edge_alone)


def without_the_apex(patch):
    motion = AttachedLines._motion

    def lobe_alone(*args):
        edge, lobe = motion(*args)
        return stop_gradient(edge), lobe

    patch.setattr(AttachedLines, "_motion", lobe_alone)


def with_fixed_shares(patch):
    balance = path._balance
    patch.setattr(path, "_balance", lambda *args: stop_gradient(balance(*args)))


def with_all_light_of_emitters(patch):
    patch.setattr(line_sampling.EmitterLines, "_share", lambda lines, vertex, *_: jnp.ones(vertex.shape))


def with_both_kinds_of_lines(patch):
    """What `LobeLines` finds in the lobe as well."""
    term = jd.LineSampling._term

    def everywhere(self, lines, paths, carries, key):
        if isinstance(lines, line_sampling.LobeLines):
            carries = attached_lines.luminance(paths.table.throughput)
        return term(self, lines, paths, carries, key)

    patch.setattr(jd.LineSampling, "_term", everywhere)


def with_one_kind_of_lines(patch):
    term = jd.LineSampling._term

    def but_attached(self, lines, paths, carries, key):
        return 0.0 if isinstance(lines, AttachedLines) else term(self, lines, paths, carries, key)

    patch.setattr(jd.LineSampling, "_term", but_attached)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "broken"),
    [
        ("roof", without_creases),
        ("sky", without_turning),
        ("sky", without_the_apex),
        ("lamp", with_fixed_shares),
        ("eclipse", with_all_light_of_emitters),
        ("sky", with_both_kinds_of_lines),
        ("lamp", with_one_kind_of_lines),
    ],
)
def test_broken_on_purpose(case, broken, monkeypatch):
    """Each part is needed: without it a derivative is off."""
    broken(monkeypatch)
    jax.clear_caches()
    with pytest.raises(AssertionError, match="is off"):
        check(case, PLAIN, alone=True, quick=True, depth=DEPTHS[case], keys=24)
    jax.clear_caches()


def cornered(film) -> jd.Scene:
    """A folded screen on a glossy floor before a glossy wall: lobes behind lobes, and behind diffuse surfaces."""
    floor = jd.Mesh([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], [[0, 1, 2], [0, 2, 3]])
    wall = jd.Mesh([[-2, 1, 0.1], [2, 1.2, 0.1], [2, 1.2, 2], [-2, 1, 2]], [[0, 1, 2], [0, 2, 3]])
    screen = jd.Mesh(
        [[-0.6, 0.3, 0.15], [0.0, -0.1, 0.1], [0.6, 0.4, 0.15], [-0.6, 0.3, 0.8], [0.0, -0.1, 0.9], [0.6, 0.4, 0.8]],
        [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]],
    )
    lamp = jd.Mesh([[-1, -2, 2.5], [-1, -1, 2.8], [0.5, -1, 2.8], [0.5, -2, 2.5]], [[0, 1, 2], [0, 2, 3]])
    return jd.Scene(
        shapes={
            "floor": jd.Shape(floor, Phong(0.2, 0.5)),
            "wall": jd.Shape(wall, Phong(0.15, (0.8, 0.6, 0.4))),
            "screen": jd.Shape(screen, jd.TwoSided(jd.Diffuse((0.4, 0.6, 0.7)))),
            "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(6.0)),
        },
        camera=jd.Perspective(jd.look_at([0.3, -3.5, 1.6], [0, 0, 0.4], [0, 0, 1]), 30.0, film),
        environment=jd.ConstantEnvironment(0.3),
    )


@pytest.mark.slow
@pytest.mark.parametrize("pixel_filter", [jd.Box(), jd.Gaussian(0.5)], ids=["one form", "two forms"])
def test_the_forms_agree(pixel_filter):
    """Of lobes at any vertex, sliding or not, with first hits in one form or in two (near field)."""
    of = cornered(jd.Film(12, 12, pixel_filter))
    rng = np.random.default_rng(0)
    weights = jnp.asarray(rng.uniform(0.5, 1.5, (12, 12, 3)), jnp.float32)
    names = [name for name in of.parameters() if name.endswith("vertices")] + ["camera.to_world"]

    def gradient(boundary):
        def loss(values, key):
            image = jd.render(of.replace(values), key, 32, jd.PathTracer(4, boundary))
            return (weights * image).mean()

        compiled = jax.jit(jax.grad(loss))
        values = {name: of.parameters()[name] for name in names}
        rows = [jax.device_get(compiled(values, key)) for key in jax.random.split(jax.random.key(1), 48)]
        return {name: np.stack([row[name] for row in rows]).astype(float) for name in names}

    material, attached = gradient(MATERIAL), gradient(ATTACHED)
    for name in names:
        for axis in range(3):
            one, two = (
                (g[name][:, axis, 3] if name == "camera.to_world" else g[name][..., axis].sum(-1))
                for g in (material, attached)
            )
            error = np.hypot(one.std(ddof=1), two.std(ddof=1)) / np.sqrt(len(one))
            print(name, axis, one.mean(), two.mean(), "±", error, "sd", one.std(ddof=1), two.std(ddof=1))
            assert abs(one.mean() - two.mean()) < 4.5 * error, (name, axis)


@pytest.mark.slow
def test_narrower_lobes():
    """Noise of derivative images (standard deviation of a pixel), printed; the forms agree at any width."""
    of = cornered(jd.Film(12, 12, jd.Box()))
    names = ("wall.vertices", "screen.vertices")
    at = {name: of.parameters()[name] for name in names}
    still = {name: jnp.zeros_like(value) for name, value in at.items()}
    motions = {
        "wall turns": still | {names[0]: jnp.cross(jnp.asarray([0.0, 0.0, 1.0]), at[names[0]])},
        "screen along x": still | {names[1]: jnp.zeros_like(at[names[1]]).at[:, 0].set(1.0)},
    }

    def images(boundary):
        @jax.jit
        def derivative(of, tangent, key):
            return jax.jvp(lambda v: jd.render(of.replace(v), key, 8, jd.PathTracer(3, boundary)), (at,), (tangent,))[1]

        def rows(width, motion):
            changed = of.replace({f"{name}.bsdf.width": jnp.asarray(width) for name in ("floor", "wall")})
            keys = jax.random.split(jax.random.key(5), 24)
            return np.stack([np.asarray(derivative(changed, motions[motion], key), float) for key in keys])

        return {(width, motion): rows(width, motion) for width in (0.3, 0.1, 0.03) for motion in motions}

    material, attached = images(MATERIAL), images(ATTACHED)
    for case, one in material.items():
        two = attached[case]
        noise = [np.sqrt(np.mean(rows.var(0, ddof=1))) for rows in (one, two)]
        difference = one.mean((1, 2, 3)) - two.mean((1, 2, 3))
        error = difference.std(ddof=1) / np.sqrt(len(one))
        print(case, "noise", noise, "difference of the means", difference.mean(), "±", error, "of", two.mean())
        assert abs(difference.mean()) < 4.5 * error, case


@pytest.mark.slow
def test_modes_and_precision():
    """Reverse mode is the transpose of forward mode in float64, which is near float32."""
    key = jax.random.key(2)

    def both():
        of = scene(**CASES["lamp"], alone=True)
        values = of.parameters()
        tangent = {
            name: jnp.asarray(np.random.default_rng(3).normal(size=v.shape), v.dtype) for name, v in values.items()
        }

        def mean(values):
            return jd.render(of.replace(values), key, 16, jd.PathTracer(2, PLAIN)).mean()

        forward = jax.jit(lambda v, t: jax.jvp(mean, (v,), (t,))[1])(values, tangent)
        reverse = jax.jit(jax.grad(mean))(values)
        return float(forward), sum(float((reverse[name] * tangent[name]).sum()) for name in values)

    forward, reverse = both()
    assert abs(forward - reverse) < 1e-4 * abs(forward)
    with jax.enable_x64(True):
        forward64, reverse64 = both()
    assert abs(forward64 - reverse64) < 1e-10 * abs(forward64)
    assert abs(forward - forward64) < 0.05 * abs(forward64)


def test_emitter_sampling_alone_is_refused():
    with pytest.raises(ValueError, match='attached lobes need sampling="mis"'):
        jd.PathTracer(boundary=ATTACHED, sampling="emitter")
    with pytest.raises(ValueError, match="attached must not be negative"):
        jd.LineSampling(attached=-0.1)
