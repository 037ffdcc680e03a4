"""Emitters of Mitsuba scene files: what is read, and images under each of them compared with Mitsuba's."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.formats.mitsuba.load import load_mitsuba

SENSOR = """<sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0, -7, 4" target="0, 0, 0.5" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="24"/>
        <boolean name="sample_border" value="true"/><rfilter type="box"/></film></sensor>"""
SHAPES = """<shape type="rectangle" id="floor"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
    <transform name="to_world"><scale value="4"/></transform></shape>
    <shape type="cube"><bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.5, 0.3"/></bsdf>
        <transform name="to_world"><scale value="0.6"/><rotate z="1" angle="20"/><translate z="0.6"/></transform>
    </shape>"""
LOOK = '<transform name="to_world"><lookat origin="{}" target="0.3, 0.2, 0" up="0, 0.2, 1"/></transform>'
TURN = '<transform name="to_world"><rotate x="1" angle="90"/><rotate z="1" angle="200"/></transform>'
EMITTERS = {
    "point": '<emitter type="point" id="lamp"><point name="position" value="2, -2, 3"/>'
    '<rgb name="intensity" value="9, 6, 3"/></emitter>',
    "point, spectrum": '<emitter type="point">'
    '<spectrum name="intensity" value="5"/><transform name="to_world"><translate x="-1" z="4"/></transform></emitter>',
    "spot": f'<emitter type="spot">{LOOK.format("2, -2, 3")}<rgb name="intensity" value="9, 6, 3"/></emitter>',
    "wide spot": f'<emitter type="spot">{LOOK.format("1, -3, 3")}<float name="cutoff_angle" value="35"/>'
    '<float name="beam_width" value="5"/><float name="intensity" value="12"/></emitter>',
    "spot, texture": f'<emitter type="spot">{LOOK.format("2, -2, 3")}<rgb name="intensity" value="90, 60, 30"/>'
    '<float name="cutoff_angle" value="50"/><texture type="bitmap" name="texture">'
    '<string name="filename" value="p.exr"/></texture></emitter>',
    "projector, constant": f'<emitter type="projector">{LOOK.format("2, -2, 3")}<float name="fov" value="100"/>'
    '<rgb name="irradiance" value="4, 3, 2"/></emitter>',
    "directional": '<emitter type="directional"><vector name="direction" value="0.5, 1, -2"/>'
    '<rgb name="irradiance" value="3, 2, 1"/></emitter>',
    "directional, turned": f'<emitter type="directional">{LOOK.format("2, -2, 3")}</emitter>',
    "projector": f'<emitter type="projector">{LOOK.format("2, -2, 3")}<float name="fov" value="40"/>'
    '<float name="scale" value="4"/><texture type="bitmap" name="irradiance"><string name="filename" value="p.exr"/>'
    "</texture></emitter>",
    "projector, fov along y, clamped": f'<emitter type="projector">{LOOK.format("0, -3, 3")}'
    '<float name="fov" value="40"/><string name="fov_axis" value="y"/><texture type="bitmap" name="irradiance">'
    '<string name="filename" value="p.png"/><string name="wrap_mode" value="clamp"/></texture></emitter>',
    "envmap": f'<emitter type="envmap"><string name="filename" value="e.exr"/><float name="scale" value="0.5"/>{TURN}'
    "</emitter>",
    "area, texture": '<shape type="rectangle"><emitter type="area"><texture type="bitmap" name="radiance">'
    '<string name="filename" value="panel.exr"/></texture></emitter><transform name="to_world">'
    '<rotate x="1" angle="100"/><translate y="2.2" z="1.5"/></transform></shape>',
    "envmap, hdr": '<emitter type="envmap"><string name="filename" value="e.hdr"/></emitter>',
}


@pytest.fixture
def write(scene_file, tmp_path):
    rng = np.random.default_rng(1)
    picture = rng.uniform(0, 1, (6, 9, 3)).astype(np.float32)
    jd.write_image(tmp_path / "p.exr", picture)
    jd.write_image(tmp_path / "p.png", picture)
    jd.write_image(tmp_path / "panel.exr", 5 * picture**4)
    sky = rng.exponential(size=(8, 16, 3)).astype(np.float32)
    sky[3, 5] *= 20
    jd.write_image(tmp_path / "e.exr", sky)
    jd.write_image(tmp_path / "e.hdr", sky)
    return lambda content: scene_file(SENSOR + SHAPES + content)


@pytest.fixture
def mitsuba():
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("llvm_ad_rgb")
    yield mi
    if before is not None:
        mi.set_variant(before)


@pytest.mark.parametrize("name", EMITTERS)
def test_an_image_as_in_mitsuba(mitsuba, write, name):
    """Pixel by pixel, within the noise of both."""
    path = write(EMITTERS[name])
    integrator = mitsuba.load_dict({"type": "path", "max_depth": 2})
    theirs = mitsuba.load_file(str(path))
    noisy = "envmap" in name or "area" in name
    spp, count = (64, 8) if noisy else (64, 16)
    expected = np.stack(
        [np.asarray(mitsuba.render(theirs, integrator=integrator, spp=spp, seed=i)) for i in range(count)]
    )
    scene = load_mitsuba(path)
    assert len(scene.lights) == (0 if noisy else 1)
    keys = jax.random.split(jax.random.key(0), count)
    found = np.stack([jd.render(scene, key, spp, jd.PathTracer(2, None)) for key in keys])
    both = [x[..., :3].reshape(count, 12, 2, 16, 2, 3).mean((2, 4)) for x in (found, expected)]
    (a, da), (b, db) = ((x.mean(0), x.std(0, ddof=1) / count**0.5) for x in both)
    error = np.hypot(da, db) + 1e-3 * b + 2e-4
    assert b.max() > 0.02
    z = np.abs(a - b) / error
    assert np.quantile(z, 0.95) < 3 and np.abs((a - b).mean((0, 1))).max() < 4e-3 * b.mean(), (np.quantile(z, 0.95),)


def test_names_and_several_lights(write):
    scene = load_mitsuba(
        write(
            EMITTERS["point"] + EMITTERS["directional"] + EMITTERS["spot"] + EMITTERS["envmap"] + EMITTERS["wide spot"]
        )
    )
    assert list(scene.lights) == ["directional", "lamp", "spot", "spot_1"]
    assert scene.environment.radiance.shape == (8, 16, 3) and scene.environment.scale == 0.5
    np.testing.assert_allclose(scene.parameters()["lamp.intensity"], [9, 6, 3])
    np.testing.assert_allclose(scene.lights["spot_1"].direction, np.array([-0.7, 3.2, -3]) / np.sqrt(19.73), rtol=1e-5)


PROBLEMS = {
    "envmap without a file": ('<emitter type="envmap"/>', "parameter 'filename' is missing"),
    "file that is not there": (
        '<emitter type="envmap"><string name="filename" value="no.hdr"/></emitter>',
        "there is no file .*no.hdr",
    ),
    "two environments": ('<emitter type="constant"/><emitter type="constant"/>', "a second environment in one <scene>"),
    "both": (
        '<emitter type="point"><point name="position" value="1, 2, 3"/>'
        '<transform name="to_world"><translate x="1"/></transform></emitter>',
        "give either position or to_world",
    ),
    "beam": ('<emitter type="spot"><float name="beam_width" value="30"/></emitter>', "beam_width < cutoff_angle"),
    "projector of a board": (
        '<emitter type="projector"><texture type="checkerboard" name="irradiance"/></emitter>',
        "unknown type 'checkerboard'; known: bitmap; with ignore_unsupported it is white",
    ),
    "spot, clamped": (
        '<emitter type="spot"><texture type="bitmap" name="texture"><string name="filename" value="p.png"/>'
        '<string name="wrap_mode" value="clamp"/></texture></emitter>',
        "wrap_mode of a spot's texture must be repeat",
    ),
    "a wide spot's texture": (
        '<emitter type="spot"><float name="cutoff_angle" value="95"/><texture type="d65" name="texture"/></emitter>',
        "cutoff_angle must be below 90",
    ),
    "wrap": (
        '<emitter type="projector"><texture type="bitmap" name="irradiance"><string name="filename" value="p.png"/>'
        '<string name="wrap_mode" value="mirror"/></texture></emitter>',
        "wrap_mode of a projected image must be clamp or repeat",
    ),
    "id": ('<emitter type="point" id="a.b"/>', "id 'a.b' can't name a light"),
    "unknown": ('<emitter type="point"><float name="power" value="1"/></emitter>', "unknown parameter 'power'"),
}


@pytest.mark.parametrize("content, message", PROBLEMS.values(), ids=PROBLEMS)
def test_problems(write, content, message):
    with pytest.raises(ValueError, match=f"<(emitter|texture|float)>: .*{message}"):
        load_mitsuba(write(content))
