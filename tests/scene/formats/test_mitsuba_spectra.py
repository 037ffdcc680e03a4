"""Spectra by wavelength: the CIE tables, the RGB that Mitsuba makes of them, what is refused."""

import numpy as np
import pytest

from jaxdr.scene.formats.mitsuba.spectra import EQUAL_ENERGY_LIGHT, TABLES, spectrum_to_rgb

from ..conftest import SENSOR

REFLECTANCE = "400:0.1, 500:0.2, 600:0.7, 700:0.9"
LAMP = "400:0, 500:8, 600:15.6, 700:18.4"


def test_tables_are_those_of_the_cie():
    nm, x, y, z, d65 = np.loadtxt(TABLES, delimiter=",", skiprows=1).T
    np.testing.assert_array_equal(nm, np.arange(360, 831, 5))
    np.testing.assert_allclose([5 * curve.sum() for curve in (x, y, z)], [106.866, 106.857, 106.893], atol=0.002)
    assert y[nm == 555] == 1 and d65[nm == 560] == 100
    white = 5 * np.array([x, y, z]) @ d65
    np.testing.assert_allclose(white[[0, 2]] / white[1], [0.95047, 1.08883], atol=2e-4)


def test_flat_spectra():
    """A grey under D65, 0.1 % darker as in Mitsuba; the same light is reddish."""
    nm, ones = np.array([300.0, 900.0]), np.ones(2)
    np.testing.assert_allclose(spectrum_to_rgb(nm, ones, False), 0.9989, atol=2e-4)
    np.testing.assert_allclose(spectrum_to_rgb(nm, ones, True), EQUAL_ENERGY_LIGHT, rtol=1e-3)
    np.testing.assert_allclose(spectrum_to_rgb(nm, 3 * ones, True), 3 * spectrum_to_rgb(nm, ones, True))


def test_spectra_end_where_their_wavelengths_do():
    red = spectrum_to_rgb(np.array([620.0, 700.0]), np.ones(2), True)
    assert red[0] > 0.5 and (red[1:] == 0).all()  # outside of the gamut: clamped


def diffuse(spectrum):
    return f'{SENSOR}<shape type="cube" id="s"><bsdf type="diffuse">{spectrum}</bsdf></shape>'


def test_in_scene_files(load, tmp_path):
    """Reflectances, lights and indices; the expected values are those that Mitsuba 3.9 prints."""
    scene = load(
        diffuse(f'<spectrum name="reflectance" value="{REFLECTANCE}"/>')
        + f'<emitter type="constant"><spectrum name="radiance" value="{LAMP}"/></emitter>'
        '<shape type="cube" id="m"><bsdf type="conductor"><spectrum name="k" value="400:4,500:5,600:6,700:7"/>'
        '<spectrum name="eta" value="400:1.6 500:1.2 600:0.9 700:0.4"/></bsdf></shape>'
    )
    found = scene.parameters()
    np.testing.assert_allclose(found["s.bsdf.reflectance"], [0.856079, 0.404085, 0.112402], rtol=1e-5)
    np.testing.assert_allclose(found["environment.radiance"], [20.7108, 10.8546, 2.77115], rtol=1e-5)
    np.testing.assert_allclose(found["m.bsdf.eta"], [0.73018, 1.07013, 1.42191], rtol=1e-5)
    np.testing.assert_allclose(found["m.bsdf.k"], [6.39381, 5.42839, 4.38776], rtol=1e-5)
    (tmp_path / "paint.spd").write_text("# nm, share\n400 0.1\n500 0.2 # green\n\n600 0.7\n700 0.9\n")
    again = load(diffuse('<spectrum name="reflectance" filename="paint.spd"/>')).parameters()
    np.testing.assert_array_equal(again["s.bsdf.reflectance"], found["s.bsdf.reflectance"])
    deep_red = load(diffuse('<spectrum name="reflectance" value="500:0, 570:0, 580:1, 830:1"/>')).parameters()
    assert deep_red["s.bsdf.reflectance"].tolist() == [1.0, pytest.approx(0.076, abs=1e-3), 0.0]  # R would be above 1


WRONG = {
    'value="0.5, 0.4, 0.3"': "expected pairs of wavelength and value such as 400:0.3, 500:0.4, got '0.5'",
    'value="400:0.1"': "two or more wavelengths",
    'value="500:0.1, 400:0.2"': "increasing order",
    'value="400:x, 500:1"': "expected numbers, got '400:x'",
    'value="400:inf, 500:1"': "must be a finite number from",
    'value="400:3, 700:3"': r"reflectance must be in \[0, 1\]",
    'filename="no.spd"': "there is no file .*no.spd",
    'filename="wrong.spd"': "wrong.spd, line 1: expected pairs of wavelength and value .*, got '400:1:2'",
}


@pytest.mark.parametrize("given", WRONG)
def test_what_is_refused(load, tmp_path, given):
    (tmp_path / "wrong.spd").write_text("400 1 2\n")
    with pytest.raises(ValueError, match=f"line 2, <.*{WRONG[given]}"):
        load(diffuse(f'<spectrum name="reflectance" {given}/>'))


def test_as_in_mitsuba(scene_file, load):
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before, random = mi.variant(), np.random.default_rng(0)
    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)  # it warns of colours outside of the gamut
    try:
        for _ in range(6):
            nm = np.sort(random.choice(np.arange(330, 860), random.integers(2, 9), replace=False))
            pairs = ", ".join(f"{x}:{v:.3f}" for x, v in zip(nm, random.random(len(nm)), strict=True))
            content = diffuse(f'<spectrum name="reflectance" value="{pairs}"/>')
            content += f'<emitter type="constant"><spectrum name="radiance" value="{pairs}"/></emitter>'
            theirs = mi.traverse(mi.load_file(str(scene_file(content))))
            ours = load(content).parameters()
            for name, end in (("s.bsdf.reflectance", "reflectance.value"), ("environment.radiance", "radiance.value")):
                (expected,) = [theirs[key] for key in theirs.keys() if key.endswith(end)]
                np.testing.assert_allclose(ours[name], list(expected), rtol=2e-5, atol=1e-5)
    finally:
        if before is not None:
            mi.set_variant(before)
