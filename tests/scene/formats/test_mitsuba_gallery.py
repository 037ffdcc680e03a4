"""Scenes written as those of galleries load unchanged, render from the command line, and look as in Mitsuba."""

import re
import warnings

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.cli import main

from ..gallery import write_gallery

SIZES = {"cornell": {"res": 20}, "veach": {"resx": 24, "resy": 16}}
EXPECTED = {
    "cornell": (8, "light", jd.Perspective),
    "veach": (5, "sphere_1", jd.Perspective),
    "preview": (3, "Exterior-mesh_0", jd.Perspective),
    "kitchen": (6, "disk", jd.Perspective),
}


@pytest.fixture(scope="module")
def gallery(tmp_path_factory):
    return write_gallery(tmp_path_factory.mktemp("gallery"))


@pytest.mark.parametrize("name", EXPECTED)
def test_it_loads_without_a_word(gallery, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = jd.load_mitsuba(gallery[name], **SIZES.get(name, {}))
    count, shape, camera = EXPECTED[name]
    assert len(scene.shapes) == count and shape in scene.shapes and isinstance(scene.camera, camera)


def test_what_is_in_them(gallery):
    cornell = jd.load_mitsuba(gallery["cornell"]).parameters()
    np.testing.assert_allclose(cornell["light.emitter.radiance"], [20.7108, 10.8546, 2.77115], rtol=1e-5)
    red, green = cornell["redwall.bsdf.reflectance"], cornell["greenwall.bsdf.reflectance"]
    assert red[0] > 4 * red[1] and green[1] > 2 * green[0]
    preview = jd.load_mitsuba(gallery["preview"])
    lacquer = preview.shapes["Exterior-mesh_0"].bsdf
    assert isinstance(lacquer, jd.RoughPlastic) and isinstance(lacquer.diffuse_reflectance, jd.Bitmap)
    kitchen = jd.load_mitsuba(gallery["kitchen"])
    np.testing.assert_allclose(kitchen.shapes["rectangle"].bsdf.bsdf.reflectance.to_uv[:, :2], 3 * np.eye(2))
    np.testing.assert_allclose(kitchen.shapes["cube"].bsdf.eta, 1.5)


def test_it_renders_from_the_command_line(gallery, tmp_path, capsys):
    out = tmp_path / "cornell.npy"
    settings = ["--set", "res=12", "--spp", "4", "--max-depth", "4", "--no-cache"]
    assert main(["render", str(gallery["cornell"]), "-o", str(out), *settings]) == 0
    assert capsys.readouterr().err == ""
    image = np.load(out)
    assert image.shape == (12, 12, 3) and np.isfinite(image).all() and (image.max(-1) > 0).mean() > 0.8


WITHOUT_EFFECT = {
    "banner": '<film type="hdrfilm"><boolean name="banner" value="true"/></film>',
    "capitals": '<film type="hdrfilm"><string name="pixel_format" value="RGB"/></film>',
    "focus": '<float name="focus_distance" value="3"/>',
    "strength": '<sampler type="orthogonal"><integer name="strength" value="2"/></sampler>',
}


@pytest.mark.parametrize("setting", WITHOUT_EFFECT.values(), ids=WITHOUT_EFFECT)
def test_settings_of_sensors_that_change_nothing(load, setting):
    scene = load(f'<sensor type="perspective">{setting}</sensor><shape type="cube"/>')
    assert scene.camera.film == load('<sensor type="perspective"/><shape type="cube"/>').camera.film


def test_integrators_that_show_the_same_image(load):
    """`volpath` without media; what an `aov` integrator adds to the one inside. What is inside is checked."""
    outer = '<integrator type="aov"><string name="aovs" value="d:depth"/><integrator type="{}"/></integrator>'
    for text in ('<integrator type="volpath"/>', '<integrator type="ptracer"/>', outer.format("path")):
        load(f'<sensor type="perspective"/><shape type="cube"/>{text}')
    with pytest.raises(ValueError, match="line 2, <integrator>: unknown type 'stokes'"):
        load(f'<sensor type="perspective"/><shape type="cube"/>{outer.format("stokes")}')


def test_sampling_weights_of_emitters_are_a_matter_of_noise(load):
    weight = '<float name="sampling_weight" value="3"/>'
    lamp = f'<shape type="rectangle" id="a"><emitter type="area">{weight}</emitter></shape>'
    scene = load(f'<sensor type="perspective"/>{lamp}<emitter type="point">{weight}</emitter>')
    assert scene.parameters()["a.emitter.radiance"].tolist() == [1.0] * 3 and list(scene.lights) == ["point"]


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
def test_images_as_in_mitsuba(gallery, name):
    """z of every pixel and of the whole image; spheres are tessellated, and Mitsuba's pixels weight their samples."""
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    path = gallery[name].with_name(f"{name}_peer.xml")
    text = gallery[name].read_text().replace("lookAt", "lookat")  # Mitsuba 3 no longer takes the other
    # Our pixels at the border always see beyond the film.
    path.write_text(re.sub("(<film [^>]*>)", r'\1<boolean name="sample_border" value="true"/>', text))
    sizes, depth, spp, count = SIZES.get(name, {}), 5, 128, 12
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    try:
        path_tracer = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 1000})
        scene = mi.load_file(str(path), **{key: str(value) for key, value in sizes.items()})
        images = [mi.render(scene, integrator=path_tracer, spp=spp, seed=seed) for seed in range(count)]
        theirs = np.stack([np.array(image)[..., :3] for image in images]).astype(float)
    finally:
        if before is not None:
            mi.set_variant(before)
    scene, tracer = jd.load_mitsuba(gallery[name], **sizes), jd.PathTracer(max_depth=depth, boundary=None)
    render = jax.jit(lambda scene, key: jd.render(scene, key, spp, tracer))
    ours = np.stack([render(scene, key) for key in jax.random.split(jax.random.key(0), count)]).astype(float)
    error = np.sqrt((ours.var(0, ddof=1) + theirs.var(0, ddof=1)) / count)
    z = (ours.mean(0) - theirs.mean(0)) / (error + 1e-3 * theirs.mean(0) + 1e-5)
    assert np.mean(np.abs(z) > 3) < 0.03, (np.mean(np.abs(z) > 3), z.mean(), z.std())
    whole = [image.mean((1, 2, 3)) for image in (ours, theirs)]
    spread = np.sqrt(sum(w.var(ddof=1) for w in whole) / count)
    assert abs(whole[0].mean() - whole[1].mean()) < 4 * spread + 3e-3 * whole[1].mean(), (whole, spread)
