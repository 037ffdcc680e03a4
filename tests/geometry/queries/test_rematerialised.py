"""What loops keep of their turns: the answers of queries, and nothing that arithmetic finds again."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from experiments import program_size
from jaxdr.geometry import queries
from jaxdr.scene.packed import pack

TURNS = 3
CAMERA = jd.Perspective(jd.look_at((0, 0, 3), (0, 0, 0), (0, 1, 0)), 40.0, film=jd.Film(4, 4))
SCENE = jd.Scene({"plane": jd.Shape(jd.shapes.rectangle(), emitter=jd.AreaEmitter(1.0))}, CAMERA)


def total(x, body):
    """Rays downwards onto the unit square, every turn from a little further; a sum of what is derived from the hits."""
    geometry = pack(SCENE).geometry

    @body
    def turn(x, index):
        origin = jnp.stack([x, x, jnp.ones_like(x)], -1)
        down = jnp.broadcast_to(jnp.array([0.0, 0.0, -1.0]), origin.shape)
        hit = queries.closest_hit(geometry, queries.Rays(origin, down, jnp.full(x.shape, 9.0)), "warp")
        x = jnp.exp(jnp.sin(x)) * jnp.cos(3.0 * x) * jnp.where(hit.face >= 0, hit.t, 0.0) + 0.1
        return x, (x**2).sum()

    return jax.lax.scan(turn, x, jnp.arange(TURNS))[1].sum()


def test_queries_run_once_and_derivatives_are_the_same():
    x = jnp.linspace(-0.5, 0.5, 5)
    found = {}
    for name, body in (("kept", lambda f: f), ("computed again", queries.rematerialised)):
        gradient = jax.jit(jax.grad(lambda x, body=body: total(x, body)))
        found[name] = np.asarray(gradient(x))
        assert program_size.call_sites(gradient.lower(x).as_text(), "closest_hit") == 1
    np.testing.assert_allclose(found["computed again"], found["kept"], rtol=1e-6)
    assert np.abs(found["kept"]).min() > 0


def test_nothing_but_answers_is_kept_of_every_turn():
    """Arrays with one row for every turn: of hits and of what turns start from, not of sines and products."""

    def kept(body):
        equations = program_size.equations(jax.make_jaxpr(jax.grad(lambda x: total(x, body)))(jnp.zeros(5)).jaxpr)
        scans = [e for e in equations if e.primitive.name == "scan"]
        return max(sum(v.aval.shape[:2] == (TURNS, 5) for v in scan.outvars) for scan in scans)

    assert kept(queries.rematerialised) < kept(lambda f: f)
