"""Images through every kind of camera as Mitsuba renders them: crop windows, clip planes, principal point, lens."""

import jax
import numpy as np
import pytest

import jaxdr as jd

SCENE = """<scene version="3.0.0">
<sensor type="{kind}">{content}<float name="near_clip" value="{near}"/><float name="far_clip" value="{far}"/>
    <transform name="to_world">{scale}<lookat origin="0.3, -6, 3" target="0, 0, 0.4" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="30"/><integer name="height" value="24"/>
        <integer name="crop_offset_x" value="3"/><integer name="crop_offset_y" value="2"/>
        <integer name="crop_width" value="22"/><integer name="crop_height" value="20"/>
        <string name="pixel_format" value="rgb"/><boolean name="sample_border" value="true"/>
        <rfilter type="box"/></film></sensor>
<shape type="cube" id="a"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
    <transform name="to_world"><rotate z="1" angle="25"/></transform></shape>
<shape type="rectangle" id="b"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf></shape>
<shape type="rectangle" id="l"><emitter type="area"><rgb name="radiance" value="4, 6, 8"/></emitter>
    <transform name="to_world"><rotate x="1" angle="180"/><translate x="1" z="4"/></transform></shape>
<emitter type="constant"><rgb name="radiance" value="0.3"/></emitter>
<integrator type="path"><integer name="max_depth" value="2"/></integrator></scene>"""
LENS = '<float name="aperture_radius" value="0.4"/><float name="focus_distance" value="5.5"/>'
FOV = '<float name="fov" value="45"/>'
# Near plane through the cube, far plane through the floor.
CAMERAS = {
    "perspective": {
        "kind": "perspective",
        "content": FOV + '<float name="principal_point_offset_x" value="0.1"/>'
        '<float name="principal_point_offset_y" value="-0.05"/>',
    },
    "perspective, clipped": {"kind": "perspective", "content": FOV, "near": 5.5, "far": 8.0},
    "lens": {"kind": "thinlens", "content": FOV + LENS},
    "lens, clipped": {"kind": "thinlens", "content": FOV + LENS, "near": 5.5, "far": 8.0},
    "parallel": {"kind": "orthographic", "scale": '<scale x="2.5" y="3"/>'},
    "parallel, clipped": {"kind": "orthographic", "scale": '<scale x="2.5" y="2.5"/>', "near": 5.5, "far": 8.0},
}
PARTS = 8


@pytest.mark.parametrize("name", CAMERAS)
def test_images_as_in_mitsuba(name, tmp_path):
    """z-test of every pixel, from independent parts of both images."""
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(**({"content": "", "scale": "", "near": 0.01, "far": 1e4} | CAMERAS[name])))
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        theirs = mi.load_file(str(path))
        expected = np.stack([np.asarray(mi.render(theirs, spp=64, seed=seed)) for seed in range(PARTS)]).astype(float)
    finally:
        if before is not None:
            mi.set_variant(before)
    scene = jd.load_mitsuba(path)
    image = jax.jit(lambda key: jd.render(scene, key, spp=64, integrator=jd.PathTracer(max_depth=2, boundary=None)))
    ours = np.stack([image(key) for key in jax.random.split(jax.random.key(0), PARTS)]).astype(float)
    assert ours.shape == expected.shape == (PARTS, 20, 22, 3)
    ours, expected = ours.mean(-1), expected.mean(-1)
    difference = ours.mean(0) - expected.mean(0)
    variance = (ours.var(0, ddof=1) + expected.var(0, ddof=1)) / PARTS
    z = difference / np.sqrt(variance + 1e-8)
    assert np.abs(difference.mean()) < 4 * np.sqrt(variance.mean() / difference.size) + 1e-3 * expected.mean()
    assert np.quantile(np.abs(z), 0.95) < 3.2 and np.abs(difference).max() < 0.15, (z, difference)
