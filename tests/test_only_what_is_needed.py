"""Only what the scene needs is compiled, and models are added from outside: one class and one line in a registry."""

import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxdr as jd
from jaxdr import boundary, cli
from jaxdr.boundary.film.film_chains import FilmChains
from jaxdr.boundary.film.hard_shadows import HardShadows
from jaxdr.boundary.film.pixel_borders import PixelBorders
from jaxdr.geometry.shapes import rectangle, sphere
from jaxdr.scene.bsdf.base import BSDF, both_above
from jaxdr.scene.formats.mitsuba.bsdfs import BSDFS
from jaxdr.scene.formats.mitsuba.xml import NUMBER, Properties
from jaxdr.scene.packed import PackedScene

KEY = jax.random.key(0)


class Chalk(BSDF):
    """A toy model: Lambertian reflection, sampled evenly over the hemisphere."""

    whiteness: Float[Array, "*n"]

    def __init__(self, whiteness=0.5):
        self.whiteness = jnp.asarray(whiteness, float)

    def eval(self, wi, wo):
        cosine = jnp.where(both_above(wi, wo), wo[..., 2], 0.0)
        return jnp.broadcast_to((self.whiteness * cosine / math.pi)[..., None], wo.shape)

    def pdf(self, wi, wo):
        return jnp.where(both_above(wi, wo), 0.5 / math.pi, 0.0)

    def sample(self, wi, u):
        radius, angle = jnp.sqrt(u[..., 0] * (2 - u[..., 0])), 2 * math.pi * u[..., 1]
        return jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle), 1 - u[..., 0]], -1)


class Borrowed(eqx.Module):
    """A toy boundary estimator: somebody else's."""

    inside: jd.KernelDensity = eqx.field(static=True, default=jd.KernelDensity(0.05))
    name: ClassVar[str] = "boundary"

    def prepare(self, context, key):
        return self.inside.prepare(context, key)

    def draw(self, context, state, chunk, key):
        return self.inside.draw(context, state, chunk, key)

    def image(self, context, state, chunk, held, answers):
        return self.inside.image(context, state, chunk, held, answers)


def scene(bsdf: BSDF) -> jd.Scene:
    light = jd.Mesh([[-1, -1, 3], [-1, 1, 3], [1, 1, 3], [1, -1, 3]], [[0, 1, 2], [0, 2, 3]])
    shapes = {
        "ball": jd.Shape(sphere(1), bsdf),
        "floor": jd.Shape(rectangle(8.0, 8.0, (0.0, 0.0, -1.5))),
        "light": jd.Shape(light, jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
    }
    return jd.Scene(shapes, jd.Perspective(jd.look_at([0.5, -5, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 6)))


def program(of: jd.Scene) -> str:
    """The lowered program of an image and its derivative by the vertices."""

    def run(vertices, key):
        def image(v):
            tracer = jd.PathTracer(max_depth=2, boundary=jd.LineSampling())  # rules would choose by the ball's BSDF
            return jd.render(of.replace({"ball.vertices": v}), key, spp=2, integrator=tracer)

        return jax.jvp(image, (vertices,), (jnp.ones_like(vertices),))

    jax.clear_caches()
    return jax.jit(run).lower(of.parameters()["ball.vertices"], KEY).as_text()


def refuse(*arguments):
    raise AssertionError("a model that the scene does not have was asked")


def test_a_diffuse_scene_pays_for_nothing_else(monkeypatch):
    """The same program whatever other models there are, and none of their code takes part in it."""
    plain = program(scene(jd.Diffuse(0.5)))
    with_others = {"RoughPlastic": program(scene(jd.RoughPlastic(0.2)))}
    monkeypatch.setitem(BSDFS, "chalk", lambda element: Chalk())
    monkeypatch.setitem(boundary.ESTIMATORS, "Borrowed", Borrowed)
    with_others["Chalk"] = program(scene(Chalk()))
    assert program(scene(jd.Diffuse(0.5))) == plain
    sizes = {name: len(text) for name, text in with_others.items()}
    assert min(sizes.values()) > 1.02 * len(plain), (len(plain), sizes)

    others = {kind for kind in _subclasses(BSDF) if kind is not jd.Diffuse}
    assert {Chalk, jd.RoughConductor, jd.Principled, jd.RoughDielectric} <= others
    for kind in others:
        for name in ("eval", "pdf", "sample", "sample_delta", "lobe_width"):
            if name in vars(kind):
                monkeypatch.setattr(kind, name, refuse)
    for texture in (jd.Bitmap, jd.Checkerboard, jd.VertexColors):  # of BSDFs, and of the light
        monkeypatch.setattr(texture, "lookup", refuse)
    monkeypatch.setattr(PackedScene, "texture_point", refuse)
    for term in (FilmChains, HardShadows, PixelBorders):
        for name in ("draw", "image"):
            monkeypatch.setattr(term, name, refuse)
    assert program(scene(jd.Diffuse(0.5))) == plain


def _subclasses(kind):
    return {kind}.union(*(_subclasses(sub) for sub in kind.__subclasses__())) - {BSDF}


def test_a_camera_without_a_lens_pays_for_none(monkeypatch):
    plain = program(scene(jd.Diffuse(0.5)))
    for name in ("view", "blur", "turns"):
        monkeypatch.setattr(jd.ThinLens, name, refuse)
    monkeypatch.setattr(jd.Orthographic, "view", refuse)
    assert program(scene(jd.Diffuse(0.5))) == plain


XML = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0.5, -5, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film></sensor>
<shape type="cube" id="box"><bsdf type="%s"/></shape>
<emitter type="constant"/></scene>"""


def _chalk(element):
    return Chalk(Properties(element).value("whiteness", NUMBER, 0.5))


def test_a_bsdf_from_outside(monkeypatch, tmp_path):
    """One class, one line: the loader knows it, its parameters have names, and it renders like what it is."""
    monkeypatch.setitem(BSDFS, "chalk", _chalk)
    images = {}
    for kind in ("chalk", "diffuse"):
        path = tmp_path / f"{kind}.xml"
        path.write_text(XML % kind)
        of = jd.load_mitsuba(path)
        images[kind] = jd.render(of, KEY, spp=256, integrator=jd.PathTracer(max_depth=2, boundary=None))
    assert isinstance(jd.load_mitsuba(tmp_path / "chalk.xml").shapes["box"].bsdf, Chalk)
    np.testing.assert_allclose(images["chalk"], images["diffuse"], atol=0.03)
    of = jd.load_mitsuba(tmp_path / "chalk.xml")

    def total(whiteness):
        moved = of.replace({"box.bsdf.whiteness": whiteness})
        return jd.render(moved, KEY, spp=16, integrator=jd.PathTracer(max_depth=2, boundary=None)).sum()

    # Single scattering is linear in it.
    change, white = jax.grad(total)(jnp.asarray(0.5)), images["chalk"].sum() - total(jnp.asarray(0.0))
    np.testing.assert_allclose(0.5 * change, white, rtol=0.05)


def test_a_boundary_estimator_from_outside(monkeypatch, tmp_path):
    """One class, one line: the command line knows it."""
    monkeypatch.setitem(boundary.ESTIMATORS, "Borrowed", Borrowed)
    monkeypatch.setitem(boundary.ESTIMATORS, "Lender", lambda: jd.KernelDensity(0.05))
    (tmp_path / "scene.xml").write_text(XML % "diffuse")
    results = []
    for name in ("Borrowed", "Lender"):
        arguments = ["gradient", str(tmp_path / "scene.xml"), "--wrt", "box.rotate.z", "--boundary", name]
        assert cli.main([*arguments, "--spp", "1", "--max-depth", "2", "-o", str(tmp_path / f"{name}.npy")]) == 0
        results.append(np.load(tmp_path / f"{name}.npy"))
    np.testing.assert_array_equal(*results)
    assert np.any(results[0] != 0)


def test_an_unknown_estimator_is_still_a_mistake(capsys):
    assert cli.main(["gradient", "scene.xml", "--wrt", "x", "-o", "x.npy", "--boundary", "Borrowed"]) == 2
    assert "got 'Borrowed' (or FILE.py:CLASS" in capsys.readouterr().err
