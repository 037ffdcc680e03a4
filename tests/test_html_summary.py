"""What notebooks show of objects: complete, escaped, and nothing to load or to run."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.html_summary import folded, summary, table, thumbnail
from jaxdr.views.evaluate import Evaluation, Score
from jaxdr.views.pictures import PictureFile
from tests.views.folders import write_nerf

ATTACK = "<script src='x'>&</script>"


def scene(name: str = "ball") -> jd.Scene:
    plate = jd.Shape(jd.shapes.rectangle(), jd.TwoSided(jd.Diffuse(0.5)), jd.AreaEmitter(2.0))
    shapes = {name: jd.Shape(jd.shapes.sphere(0), jd.Plastic(0.25)), "plate": plate}
    camera = jd.Perspective(jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1)), 30.0, jd.Film(8, 6))
    return jd.Scene(shapes, camera, jd.ConstantEnvironment(0.5), {"sun": jd.DirectionalLight((0, 0, -1))})


def words(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


def test_a_scene():
    shown = words(scene()._repr_html_())
    assert "ball Plastic 20 12" in shown and "plate TwoSided(Diffuse) 2 4 AreaEmitter" in shown
    assert "camera Perspective 8 x 6 pixels, Gaussian" in shown and "environment ConstantEnvironment" in shown
    assert "sun DirectionalLight" in shown
    assert "ball.bsdf.diffuse_reflectance [3] float32 0.25" in shown and "camera.fov [] float32 30" in shown
    assert all(name in shown for name in scene().parameters())


def test_a_tie_is_shown():
    tied = scene().replace({"plate.emitter.radiance": jnp.full(3, 0.5)})
    tied = tied.tie({"glow": ("plate.emitter.radiance", "environment.radiance")})
    assert "glow tie environment.radiance, plate.emitter.radiance" in words(tied._repr_html_()).replace(
        "plate.emitter.radiance, environment.radiance", "environment.radiance, plate.emitter.radiance"
    )


def test_a_scene_in_a_traced_function():
    found = []

    def f(of):
        found.append(of._repr_html_())
        return of.camera.fov

    jax.jit(f)(scene())
    jax.grad(lambda fov: f(scene().replace({"camera.fov": fov})))(30.0)
    assert "camera.fov [] float32 traced" in words(found[0])
    assert "camera.fov [] float32 traced" in words(found[1]) and "0.25" in found[1]


def test_what_is_left_of_a_scene():
    """Gradients have no whole numbers, and parts of scenes other leaves."""
    of = scene()
    slopes = eqx.filter_grad(lambda s: s.camera.fov * 2.0)(of)
    assert "camera.fov [] float32 2" in words(slopes._repr_html_())
    for other in (jax.tree.map(lambda _: None, of), jax.tree.map(lambda _: True, of), jax.eval_shape(lambda: of)):
        assert "plate TwoSided(Diffuse)" in words(other._repr_html_())
    nan = jax.tree.map(lambda x: x * jnp.nan if x.dtype == jnp.float32 else x, of)
    assert "nan" in nan._repr_html_()


def test_a_plan():
    plan = jd.Plan(jd.PathTracer(max_depth=2), 4, (f"estimator: {ATTACK}: a", "words"))
    page = plan._repr_html_()
    assert "<script" not in page
    assert "spp 4 estimator &lt;script src=&#x27;x&#x27;&gt;&amp;&lt;/script&gt;: a words" in words(page)


def raises(picture):
    raise ValueError("damaged")


def test_photographs(tmp_path, monkeypatch):
    views = jd.load_views(write_nerf(tmp_path, train=8, test=1))
    page = views._repr_html_()
    assert "8 + 1 photographs" in page and page.count('<img src="data:image/png;base64,') == 6
    assert "… and 3 more" in page
    monkeypatch.setattr(PictureFile, "read", raises)
    page = views._repr_html_()
    assert "<img" not in page and "r_0: can't be read" in page
    assert "no photographs" in jd.Views(tmp_path, ())._repr_html_()


def test_scores():
    scores = (Score(ATTACK, 30.0, 0.9, None), Score("b", 20.0, 0.7, None))
    page = Evaluation(scores)._repr_html_()
    assert "<script" not in page
    assert "view PSNR, dB SSIM mean 25.0 0.800 worst 20.0 0.700" in words(page) and "b 20.0 0.700" in words(page)


def test_words_are_escaped():
    parts = table((ATTACK,), [(ATTACK, 1)]), folded(ATTACK, ""), thumbnail(np.zeros((2, 2, 3), np.uint8), ATTACK)
    assert "<script" not in summary(ATTACK, *parts) + scene(ATTACK.replace(".", ""))._repr_html_()
