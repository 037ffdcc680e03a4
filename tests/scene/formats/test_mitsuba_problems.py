"""All problems of a scene file in one error; what is only unsupported can be ignored, with warnings."""

import warnings

import numpy as np
import pytest

from jaxdr.scene.bsdf import Diffuse, TwoSided
from jaxdr.scene.film import Gaussian

from ..conftest import SENSOR

UNSUPPORTED = """<shape type="cube" id="a"><bsdf type="twosided"><bsdf type="velvet"/></bsdf></shape>
<shape type="hair"/>
<sensor type="perspective"><float name="fov" value="30"/><float name="aperture" value="1"/>
    <film type="hdrfilm"><integer name="widht" value="9"/><rfilter type="lanczos"/></film></sensor>
<sensor type="fisheye"/>
<emitter type="sunsky"/>
<integrator type="depth"/>
<medium type="homogeneous"/>
<shape type="cube" id="b"><emitter type="beam"/>
    <bsdf type="diffuse"><texture type="noise" name="reflectance"/></bsdf></shape>"""
MESSAGES = [
    "line 2, <bsdf>: unknown type 'velvet'; known: diffuse, twosided, mask, normalmap, bumpmap, blendbsdf, "
    "mixturebsdf, roughconductor, roughdielectric, roughplastic, principled, principledthin, conductor, dielectric, "
    "thindielectric, phong, plastic; "
    "with ignore_unsupported a grey diffuse BSDF",
    "line 3, <shape>: unknown type 'hair'; known: obj, ply, serialized,",
    "line 4, <float>: unknown parameter 'aperture' of sensor 'perspective'; known: ",
    "line 5, <rfilter>: unknown type 'lanczos'; known: box, gaussian, tent; with ignore_unsupported a Gaussian",
    "line 5, <integer>: unknown parameter 'widht' of film 'hdrfilm'; did you mean 'width'?; with ignore_unsupported it",
    "line 6, <sensor>: the scene has several sensors (0: without id, 1: without id); choose one by its id or its "
    "number: sensor=0 (--set sensor=0); with ignore_unsupported the first one counts",
    "line 7, <emitter>: unknown type 'sunsky'; models of the sky are not supported; write the sky into",
    "line 8, <integrator>: unknown type 'depth'",
    "line 9, <medium>: participating media are not supported; with ignore_unsupported it is left out: space is empty",
    "line 10, <emitter>: unknown type 'beam'; known: area; with ignore_unsupported the shape does not glow",
    "line 11, <texture>: unknown type 'noise'; known: uniform, d65, bitmap, checkerboard, mesh_attribute, scale; with "
    "ignore_unsupported reflectance is 0.5",
]


def test_one_error_lists_everything_by_line(load, tmp_path):
    with pytest.raises(ValueError) as caught:
        load(UNSUPPORTED)
    first, *rest = str(caught.value).split("\n  ")
    path = tmp_path / "scene.xml"
    assert first == f"{path} has {len(MESSAGES)} problems:"
    for message, expected in zip(rest, MESSAGES, strict=True):
        assert message.startswith(f"{path}, {expected}")


def test_what_is_unsupported_can_be_ignored(load):
    with pytest.warns(UserWarning) as caught:
        scene = load(UNSUPPORTED, ignore_unsupported=True)
    assert len(caught) == len(MESSAGES)
    for warning, expected in zip(caught, MESSAGES, strict=True):
        assert expected in str(warning.message)
    assert list(scene.shapes) == ["a", "b"] and scene.environment is None and scene.shapes["b"].emitter is None
    grey = scene.shapes["a"].bsdf
    assert isinstance(grey, TwoSided) and np.array_equal(grey.bsdf.reflectance, [0.5] * 3)
    assert isinstance(scene.shapes["b"].bsdf, Diffuse)
    assert float(scene.camera.fov) == 30 and scene.camera.film.width == 768 and scene.camera.film.filter == Gaussian()


def test_ids_that_make_no_parameter_names_change(load):
    text = SENSOR + '<shape type="cube" id="a.001"/><shape type="cube" id="camera"/><shape type="cube" id=""/>'
    with pytest.raises(ValueError, match=r"line 2, <shape>: id 'a\.001' can't name a shape .*; give it another"):
        load(text)
    with pytest.warns(UserWarning) as caught:
        assert list(load(text, ignore_unsupported=True).shapes) == ["_shape", "a_001", "camera_shape"]
    endings = [str(warning.message).split("with ignore_unsupported ")[1] for warning in caught]
    assert endings == [f"it is called '{name}'" for name in ("a_001", "camera_shape", "_shape")]


def test_mistakes_are_never_ignored(load):
    text = """<shape type="sphere"><float name="radius" value="-1"/></shape>
    <shape type="hair"/>
    <shape type="obj"><string name="filename" value="no.obj"/></shape>"""
    with pytest.warns(UserWarning, match="hair"), pytest.raises(ValueError) as caught:
        load(SENSOR + text, ignore_unsupported=True)
    message = str(caught.value)
    assert "2 problems" in message and "line 2, <shape>: radius must" in message and "line 4, <shape>: there" in message
    assert "hair" not in message


def test_an_object_that_is_referred_to_twice_is_listed_once(load):
    text = """<bsdf type="diffuse" id="x"><float name="roughness" value="1"/></bsdf>
    <shape type="cube"><ref id="x"/></shape><shape type="cube"><ref id="x"/></shape>"""
    with pytest.raises(ValueError, match=r"^[^\n]*scene.xml, line 2, <float>: unknown parameter 'roughness'[^\n]*$"):
        load(SENSOR + text)


def test_a_sensor_cannot_be_left_out(load):
    text = '<sensor type="fisheye"/><shape type="cube"/>'
    with (
        pytest.warns(UserWarning, match="fisheye"),
        pytest.raises(ValueError, match="line 2, <sensor>: the scene has no"),
    ):
        load(text, ignore_unsupported=True)


def test_a_good_scene_warns_of_nothing(load):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(SENSOR + '<shape type="cube"/>', ignore_unsupported=True)


def test_constant_textures(load):
    """Typed spectra are taken as they are; a plain <spectrum> on a light stands for a flat one, which is reddish."""
    uniform = '<spectrum type="uniform" name="{}"><float name="value" value="0.25"/></spectrum>'
    scene = load(
        f"""{SENSOR}<shape type="cube" id="a"><bsdf type="diffuse">{uniform.format("reflectance")}</bsdf></shape>
        <emitter type="constant"><texture type="d65" name="radiance">
            <float name="scale" value="3"/></texture></emitter>"""
    )
    assert np.array_equal(scene.parameters()["a.bsdf.reflectance"], [0.25] * 3)
    assert np.array_equal(scene.parameters()["environment.radiance"], [3.0] * 3)
