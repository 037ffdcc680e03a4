"""Every model: samples follow the density, energy, reciprocity, sides, derivatives, limits, parameters."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.bsdf.coat import internal_reflectance, transmittance
from jaxdr.scene.bsdf.fresnel import fresnel_conductor, fresnel_dielectric
from jaxdr.scene.bsdf.microfacet import DISTRIBUTIONS
from tests.scene.bsdf.checks import (
    QUICK,
    call,
    check_derivatives,
    chi2_test,
    direction,
    random_directions,
    repeated,
    sphere_integral,
    uniform,
)

COLOUR = (0.2, 0.5, 0.8)


def with_slope(slope, bump):
    """A bump map at a point where its texture has this slope."""
    return eqx.tree_at(lambda b: b.height, bump, jnp.asarray(slope, float))


def index(bsdf):
    """Of the inside of what lets light through, over that of the outside."""
    if isinstance(bsdf, jd.Blend):
        return index(bsdf.second)
    return float(bsdf._eta() if isinstance(bsdf, jd.Principled) else bsdf.eta)


MODELS = {
    "metal ggx": jd.RoughConductor(0.3, "Au"),
    "metal beckmann": jd.RoughConductor(0.15, "Al", distribution="beckmann"),
    "glass ggx": jd.RoughDielectric(0.3),
    "glass beckmann": jd.RoughDielectric(0.6, 1.2, 1.7, distribution="beckmann"),
    "plastic": jd.Plastic(COLOUR),
    "rough plastic ggx": jd.RoughPlastic(COLOUR, 0.2),
    "rough plastic beckmann": jd.RoughPlastic(COLOUR, 0.4, 1.9, distribution="beckmann", nonlinear=True),
    "principled": jd.Principled(COLOUR, 0.4, 0.5, 0.7),
    "mask": jd.Mask(0.3, jd.Principled(COLOUR, 0.9, 0.6)),
    "masked plastic": jd.Mask(0.6, jd.Plastic(COLOUR)),
    "normal map": jd.NormalMap((0.6, 0.45, 0.9), jd.Principled(COLOUR, 0.4, 0.5, 0.7)),
    "two roughnesses": jd.RoughConductor(0.4, "Au", alpha_v=0.15),
    "glass beckmann two roughnesses": jd.RoughDielectric(0.35, alpha_v=0.7, distribution="beckmann"),
    "principled lobes": jd.Principled(
        COLOUR, 0.2, 0.5, sheen=0.2, sheen_tint=0.4, clearcoat=0.9, clearcoat_gloss=0.1, flatness=0.6, spec_tint=0.5
    ),
    "principled glass": jd.Principled(
        COLOUR, 0.2, 0.6, anisotropic=0.7, clearcoat=0.6, flatness=0.3, sheen=0.2, spec_tint=0.3, spec_trans=0.7
    ),
    "phong": jd.Phong(COLOUR, 0.2, 12.0),
    "blended plastic": jd.Blend(0.6, jd.Plastic(COLOUR), jd.RoughDielectric(0.4)),
    "bump map": with_slope(
        (0.4, -0.2), jd.BumpMap(jd.Bitmap(np.ones((2, 2))), jd.RoughConductor(0.4, "Au", alpha_v=0.15), 1.5)
    ),
}
SLOW = ("beckmann two", "principled lobes")  # other models meet the same lines
models = pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if any(map(n.__contains__, SLOW)) else []) for n in MODELS]
)
# For what takes long to compile: the second distribution is in the same places of the code as the first.
slow_beckmann = pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if "beckmann" in n or n in SLOW else []) for n in MODELS]
)
ANGLES = [0.0, 1.3]


@models
def test_samples_follow_the_density(name):
    """Chi², from outside and, for glass, from inside."""
    for theta in (*ANGLES, *((2.5,) if MODELS[name].transmissive else ())):
        chi2_test(MODELS[name], direction(theta, 0.4))


BEYOND = {
    "phong": jd.Phong(COLOUR, 0.0, 12.0),
    "rough plastic ggx": jd.RoughPlastic(0.0, 0.2),
    "principled": jd.Principled(COLOUR, 0.0, 0.5, 0.7),
    "principled glass": MODELS["principled glass"],
    "mask": MODELS["mask"],
    "blended plastic": MODELS["blended plastic"],
}


@pytest.mark.parametrize(
    "name, field, value",
    [
        ("phong", "specular_reflectance", (-0.02, 0.01, 0.01)),
        ("rough plastic ggx", "diffuse_reflectance", (-0.02, -0.02, 0.01)),
        ("principled", "metallic", 1.1),
        ("principled", "metallic", 2.5),
        ("principled glass", "spec_trans", -0.1),
        ("principled glass", "clearcoat", -0.2),
        ("mask", "opacity", -0.02),
        ("mask", "opacity", 1.5),
        ("blended plastic", "weight", 1.3),
    ],
)
def test_samples_follow_the_density_beyond_the_range(name, field, value):
    """Traced parameters may leave their range, as those of an optimisation do. Densities stay densities."""
    bsdf = eqx.tree_at(lambda b: getattr(b, field), BEYOND[name], jnp.asarray(value, float))
    for theta in ANGLES[:2]:
        chi2_test(bsdf, direction(theta, 0.4))


@models
def test_energy(name):
    """∫ pdf and what delta lobes are chosen with are at most one; so is ∫ eval, which sampling estimates.

    Radiance grows by 1 / eta² where it is refracted into a medium of less index.
    """
    bsdf, count = MODELS[name], 16_384
    most = 1.002 / min(float(bsdf.eta), 1.0) ** 2 if isinstance(bsdf, jd.RoughDielectric) else 1.002
    for theta in ANGLES:
        wi, u = repeated(direction(theta, 0.4), count), uniform(count, 1)
        u = u.at[:, 0].set((jnp.arange(count) + 0.5) / count)
        chosen = (call(bsdf, "sample_delta", wi, u).probability > 0).mean()
        assert sphere_integral(lambda a, b: call(bsdf, "pdf", a, b), wi[0]) < 1.002 - chosen
        albedo = sphere_integral(lambda a, b: call(bsdf, "eval", a, b), wi[0])
        assert np.all(albedo > 0) and np.all(albedo < most)
        wo = call(bsdf, "sample", wi, u)
        density = call(bsdf, "pdf", wi, wo)[:, None] * (call(bsdf, "sample_delta", wi, u).probability == 0)[:, None]
        weight = np.where(density > 0, call(bsdf, "eval", wi, wo) / np.where(density > 0, density, 1), 0)
        error = weight.std(0) / np.sqrt(count)
        assert np.all(np.abs(weight.mean(0) - albedo) < 4 * error + 2e-3)


@pytest.mark.parametrize("name", [name for name in MODELS if " map" not in name])  # those have none
def test_reciprocity(name):
    """f(a, b) n_b² = f(b, a) n_a², with the indices n of the sides that a and b are on."""
    bsdf = MODELS[name]
    lowest = -1.0 if bsdf.transmissive else 0.05
    a, b = random_directions(300, 2, lowest), random_directions(300, 3, lowest)
    eta = index(bsdf) if bsdf.transmissive else 1.0
    n_a, n_b = (np.where(np.asarray(w[:, 2]) > 0, 1.0, eta)[:, None] for w in (a, b))
    forth = call(bsdf, "eval", a, b) * np.abs(np.asarray(a)[:, 2:]) * n_b**2
    back = call(bsdf, "eval", b, a) * np.abs(np.asarray(b)[:, 2:]) * n_a**2
    assert (forth > 0).any(1).sum() > 100
    np.testing.assert_allclose(forth, back, rtol=1e-3, atol=1e-5)


@models
def test_sides(name):
    bsdf = MODELS[name]
    wi, wo = random_directions(100, 4, 0.0), random_directions(100, 5, 0.0)
    down = jnp.asarray([1.0, 1.0, -1.0])
    value = call(bsdf, "eval", wi, wo)
    assert np.all(value >= 0) and np.any(value > 0)
    for a, b in ((wi * down, wo), (wi, wo * down), (wi * down, wo * down)):
        assert np.any(call(bsdf, "eval", a, b) != 0) == bsdf.transmissive
        assert np.any(call(bsdf, "pdf", a, b) != 0) == bsdf.transmissive
    for method in ("eval", "pdf"):
        assert np.all(call(bsdf, method, wi, jnp.zeros_like(wi)) == 0)
    width = np.asarray(bsdf.lobe_width(wi))
    assert width.shape == (100,) and np.all((width > 0) & (width <= 1))


@slow_beckmann
def test_a_row_for_every_point(name):
    """Fields with one row a point give what one model a point gives."""
    bsdf = MODELS[name]
    wi, wo = random_directions(4, 6, 0.1), random_directions(4, 7, -1.0 if bsdf.transmissive else 0.1)
    factors = jnp.asarray([1.0, 0.9, 1.1, 0.95])
    rows = [jax.tree.map(lambda x, f=f: x * f, bsdf) for f in factors]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *rows)
    u = uniform(4, 8)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def everything(bsdf, wi, wo, u):
        return bsdf.eval(wi, wo), bsdf.pdf(wi, wo), bsdf.sample(wi, u), bsdf.lobe_width(wi), *bsdf.sample_delta(wi, u)

    together = everything(stacked, wi, wo, u)
    assert [x.shape for x in together] == [(4, 3), (4,), (4, 3), (4,), (4, 3), (4, 3), (4,)]
    for i, row in enumerate(rows):
        alone = [call(row, "eval", wi, wo), call(row, "pdf", wi, wo), call(row, "sample", wi, u), row.lobe_width(wi)]
        for ours, theirs in zip(together, [*alone, *call(row, "sample_delta", wi, u)], strict=True):
            np.testing.assert_allclose(ours[i], theirs[i], rtol=1e-4, atol=1e-5)


@slow_beckmann
def test_derivatives(name):
    """eval in every field and both directions against central differences in float64."""
    with jax.enable_x64(True):
        bsdf = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), jnp.float64), MODELS[name])
        lowest = -1.0 if bsdf.transmissive else 0.05
        wi, wo = (jnp.asarray(np.asarray(random_directions(40, s, lowest)), jnp.float64) for s in (2, 3))
        moves = check_derivatives(lambda b, *directions: b.eval(*directions), (bsdf, wi, wo))
        assert moves.count(False) == ("plastic" in name and "rough" not in name)  # its mirror is a delta lobe


EDGES = {
    "metal 0.001": jd.RoughConductor(0.001, "Cu"),
    "metal 1": jd.RoughConductor(1.0),
    "beckmann 0.001": jd.RoughConductor(0.001, distribution="beckmann"),
    "beckmann glass": jd.RoughDielectric(0.001, distribution="beckmann"),
    "glass 0.001": jd.RoughDielectric(0.001),
    "glass 1": jd.RoughDielectric(1.0, 1.0, 1.5),
    "rough plastic 0.001": jd.RoughPlastic(0.0, 0.001),
    "rough plastic 1": jd.RoughPlastic(1.0, 1.0, 1.0, 1.0),
    "plastic": jd.Plastic(0.0, 1.0, 1.0, specular_reflectance=0.0),
    "sharp": jd.Principled(0.0, 1.0, 0.0, 0.0),
    "dull": jd.Principled(1.0, 0.0, 1.0, 0.0),
    "mask": jd.Mask(0.0, jd.Mask(1.0, jd.Plastic())),
    "two 0.001": jd.RoughConductor(0.001, alpha_v=1.0),
    "principled": jd.Principled(
        0.0,
        0.0,
        0.0,
        0.0,
        anisotropic=1.0,
        spec_tint=1.0,
        sheen=1.0,
        sheen_tint=1.0,
        clearcoat=1.0,
        clearcoat_gloss=1.0,
        spec_trans=1.0,
        flatness=1.0,
    ),
    "phong": jd.Phong(0.0, 1.0, 0.0),
    "sharp phong": jd.Phong(0.0, 1.0, 1e4),
    "blend": jd.Blend(0.0, jd.Plastic(), jd.Blend(1.0, jd.Phong(), jd.Dielectric())),
    "flat": with_slope((0.0, 0.0), jd.BumpMap(jd.Bitmap(np.ones((2, 2))), jd.RoughConductor(0.4, alpha_v=0.2))),
    "across": jd.NormalMap((1.0, 0.5, 0.5), jd.RoughConductor(0.2)),
    "no normal": jd.NormalMap(0.5, jd.Diffuse()),
}


@functools.partial(jax.jit, compiler_options=QUICK)
@functools.partial(jax.value_and_grad, argnums=(0, 1, 2))
def total(bsdf, wi, wo):
    return bsdf.eval(wi, wo).sum() + bsdf.pdf(wi, wo).sum()


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if "beckmann" in n else []) for n in EDGES])
def test_finite_at_the_edges(name):
    """Values and derivatives at the pole, for wi = wo, at grazing angles, inside, for opposite and zero directions."""
    near = [0.0, 1e-20, 1e-7, 1e-3, 0.8]
    some = [[np.sqrt(1 - z * z), 0.0, z] for z in near]
    some += [[-x, y, -z] for x, y, z in some] + [[-x, y, z] for x, y, z in some] + [[0, 0, 1.0], [0, 0, -1.0]]
    some = jnp.asarray(some, float)
    wi, wo = (x.reshape(-1, 3) for x in jnp.broadcast_arrays(some[:, None], some[None]))

    value, gradients = total(EDGES[name], wi, wo)
    assert np.isfinite(value)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradients))
    value, gradients = total(EDGES[name], wi, jnp.zeros_like(wo))
    assert value == 0 and all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradients))
    u = jnp.asarray([[a, b] for a in (0.0, 0.5, 1 - 2**-24) for b in (0.0, 0.5, 1 - 2**-24)])
    wi, u = jnp.repeat(some, len(u), 0), jnp.tile(u, (len(some), 1))
    length = np.linalg.norm(call(EDGES[name], "sample", wi, u), axis=-1)
    assert np.all((np.abs(length - 1) < 1e-5) | (length == 0))


def test_normal_incidence():
    """Both directions at the normal: D = 1 / (π α²), G = 1, Fresnel at normal incidence."""
    up, alpha = jnp.asarray([[0.0, 0.0, 1.0]]), 0.2
    peak = 1 / (4 * np.pi * alpha**2)
    for distribution in DISTRIBUTIONS:
        metal = jd.RoughConductor(alpha, "Au", distribution=distribution)
        fresnel = fresnel_conductor(jnp.ones(1), metal.eta, metal.k)
        np.testing.assert_allclose(call(metal, "eval", up, up), fresnel * peak, rtol=1e-5)
        np.testing.assert_allclose(call(metal, "pdf", up, up), peak, rtol=1e-5)
        glass = jd.RoughDielectric(alpha, 1.5, 1.0, distribution=distribution)
        np.testing.assert_allclose(call(glass, "eval", up, up), 0.04 * peak * np.ones((1, 3)), rtol=1e-5)
        through = 0.96 * 4 * peak / (1 - 1.5) ** 2  # Eq. 21 of Walter et al. 2007, over η²
        np.testing.assert_allclose(call(glass, "eval", up, -up), through * np.ones((1, 3)), rtol=1e-5)
        np.testing.assert_allclose(call(glass, "eval", -up, up), 1.5**2 * through * np.ones((1, 3)), rtol=1e-5)
        mirror = jd.RoughConductor(alpha, specular_reflectance=COLOUR, distribution=distribution)
        np.testing.assert_allclose(call(mirror, "eval", up, up), np.multiply(COLOUR, peak)[None], rtol=1e-5)
    principled = jd.Principled(COLOUR, 0.0, np.sqrt(alpha), 0.5)
    diffuse = np.asarray(COLOUR) / np.pi
    np.testing.assert_allclose(call(principled, "eval", up, up)[0], 0.04 * peak + diffuse, rtol=1e-4)
    metal = jd.Principled(COLOUR, 1.0, np.sqrt(alpha))
    np.testing.assert_allclose(call(metal, "eval", up, up)[0], np.multiply(COLOUR, peak), rtol=1e-5)


def test_principled_diffuse():
    """Without a dielectric lobe only Burley 2012's diffuse formula is left, here at grazing angles."""
    roughness, cosines = 0.8, np.cos([1.4, 1.3])
    wi, wo = (jnp.asarray(direction(theta, phi), float)[None] for theta, phi in ((1.4, 0.2), (1.3, 0.5)))
    half = np.asarray(wi + wo)[0] / np.linalg.norm(wi + wo)
    f_d90 = 0.5 + 2 * roughness * np.dot(half, wi[0]) ** 2
    first, second = 1 + (f_d90 - 1) * (1 - cosines) ** 5
    expected = np.multiply(COLOUR, first * second * cosines[1] / np.pi)
    found = call(jd.Principled(COLOUR, 0, roughness, 0), "eval", wi, wo)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=5e-6)  # a specular of zero counts as 0.001


def energy(bsdf, wi, eta):
    """Share of the light that arrives from wi, from outside, and is scattered: without the scaling of radiance."""

    def scattered(wi, wo):
        return call(bsdf, "eval", wi, wo)[:, 0] * np.where(wo[:, 2] < 0, eta**2, 1.0)

    return sphere_integral(scattered, wi)[0]


# 1 - E[G1(wo)] over visible normals for wi at 0.6 rad, by Heitz 2018's sampling in double precision, 400 000 samples.
GGX_LOSSES = {0.1: 0.0150, 0.3: 0.1414, 0.6: 0.4039}


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_white_furnace(distribution):
    """What is lossless reflects everything, less what facets scatter to each other: nothing as alpha goes to zero."""
    losses = []
    for alpha, expected in GGX_LOSSES.items():
        wi = direction(0.6, 0.0)
        mirror = energy(jd.RoughConductor(alpha, distribution=distribution), wi, 1.0)
        both = energy(jd.RoughDielectric(alpha, 1.5, 1.0, distribution=distribution), wi, 1.5)
        assert mirror < 1.001 and both < 1.001
        losses.append((1 - mirror, 1 - both))
        if distribution == "ggx":
            assert abs(losses[-1][0] - expected) < 0.002
    assert np.all(np.asarray(losses[0]) < 0.02) and np.all(np.diff(losses, axis=0) > 0)


def test_smooth_limit_of_rough_plastic():
    """At small alpha the coat's integrals are those of the smooth one, and the base shines as below `Plastic`."""
    wi, wo = random_directions(50, 1, 0.2), random_directions(50, 2, 0.2)
    apart = np.asarray((normalized(wi + wo))[:, 2]) < 0.98  # not the mirror direction
    rough, smooth = jd.RoughPlastic(COLOUR, 1e-3), jd.Plastic(COLOUR)
    ours, theirs = (call(model, "eval", wi, wo)[apart] for model in (rough, smooth))
    np.testing.assert_allclose(ours, theirs, rtol=0.03)


def normalized(v):
    return v / jnp.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_integrals_of_rough_plastic(distribution):
    """The quadrature and the fit against Monte Carlo of the rough interface's own reflection and refraction."""
    for alpha, eta in ((0.05, 1.5), (0.3, 1.5), (0.8, 2.0)):
        glass = jd.RoughDielectric(alpha, eta, 1.0, distribution=distribution)
        count = 32_768
        for theta in (0.3, 1.2, 1.5):
            passed = estimate(glass, repeated(direction(theta, 0.0), count)) * eta**2
            ours = transmittance(distribution, jnp.asarray(alpha), jnp.asarray(eta), jnp.asarray(np.cos(theta)))
            assert abs(ours - passed) < 0.015
        u = uniform(count, 5)
        cosine = jnp.sqrt(u[:, 0])
        inside = jnp.stack([jnp.sqrt(1 - u[:, 0]), jnp.zeros(count), -cosine], -1)  # diffuse light from below
        reflected = estimate(glass, inside)
        ours = internal_reflectance(distribution, jnp.asarray(alpha), jnp.asarray(eta))
        assert abs((1 - ours) / (1 - reflected) - 1) < 0.04


def estimate(bsdf, wi):
    """Mean over wi of ∫ eval dω below the surface, by sampling."""
    wo = call(bsdf, "sample", wi, uniform(len(wi), 6))
    density = call(bsdf, "pdf", wi, wo)
    used = (density > 0) & (wo[:, 2] < 0)
    return np.mean(np.where(used, call(bsdf, "eval", wi, wo)[:, 0] / np.where(used, density, 1), 0))


WRONG = {
    "RoughConductor: alpha must be in": lambda: jd.RoughConductor(0.0),
    "RoughConductor: alpha must be a number": lambda: jd.RoughConductor((0.1, 0.2)),
    "RoughConductor: unknown material 'Unobtainium'; known: a-C, Ag": lambda: jd.RoughConductor(0.1, "Unobtainium"),
    "RoughConductor: give both eta and k": lambda: jd.RoughConductor(0.1, eta=1.0),
    "RoughConductor: give either a material": lambda: jd.RoughConductor(0.1, "Au", eta=1.0, k=2.0),
    "Conductor: k must be at least 0": lambda: jd.Conductor(eta=1.0, k=-1.0),
    "RoughConductor: distribution must be ggx or beckmann": lambda: jd.RoughConductor(0.1, distribution="phong"),
    "RoughDielectric: int_ior and ext_ior must differ": lambda: jd.RoughDielectric(0.1, 1.5, 1.5),
    "Dielectric: int_ior: unknown material 'wood'": lambda: jd.Dielectric("wood"),
    "ThinDielectric: ext_ior must be in": lambda: jd.ThinDielectric(1.5, 0.0),
    "Plastic: diffuse_reflectance must be in": lambda: jd.Plastic(1.5),
    "RoughPlastic: int_ior / ext_ior must be in": lambda: jd.RoughPlastic(0.5, 0.1, 1.0, 1.5),
    "Principled: metallic must be in": lambda: jd.Principled(0.5, 1.5),
    "Principled: roughness must be in": lambda: jd.Principled(0.5, 0.0, float("nan")),
    "RoughConductor: alpha_v must be in": lambda: jd.RoughConductor(0.1, alpha_v=0.0),
    "Principled: sheen_tint has no effect without sheen": lambda: jd.Principled(sheen_tint=0.5),
    "Principled: clearcoat_gloss has no effect": lambda: jd.Principled(clearcoat_gloss=0.5),
    "Principled: spec_trans must be in": lambda: jd.Principled(spec_trans=1.5),
    "TwoSided: Principled lets light through": lambda: jd.TwoSided(jd.Principled(spec_trans=0.5)),
    "Phong: .* reflect up to 1.3 together": lambda: jd.Phong(0.5, (0.2, 0.8, 0.1)),
    "Phong: exponent must be at least 0": lambda: jd.Phong(exponent=-1.0),
    "Blend: second can't be a TwoSided": lambda: jd.Blend(0.5, jd.Diffuse(), jd.TwoSided(jd.Diffuse())),
    "Blend: weight must be in": lambda: jd.Blend(-0.1, jd.Diffuse(), jd.Diffuse()),
    "Blend: two mirrors or smooth glasses can't": lambda: jd.Blend(
        0.5, jd.Conductor(), jd.NormalMap(0.5, jd.Conductor())
    ),
    "BumpMap: height must be a bilinear Bitmap": lambda: jd.BumpMap(jd.Checkerboard(), jd.Diffuse()),
    "BumpMap: height must have one channel": lambda: jd.BumpMap(jd.Bitmap(np.ones((2, 2, 3))), jd.Diffuse()),
    "BumpMap: bsdf can't be a TwoSided": lambda: jd.BumpMap(jd.Bitmap(np.ones((2, 2))), jd.TwoSided(jd.Diffuse())),
    "Mask: opacity must be in": lambda: jd.Mask(1.2, jd.Diffuse()),
    "Mask: bsdf can't be a TwoSided": lambda: jd.Mask(0.5, jd.TwoSided(jd.Diffuse())),
    "TwoSided: Dielectric lets light through": lambda: jd.TwoSided(jd.Dielectric()),
    "TwoSided: Mask lets light through": lambda: jd.TwoSided(jd.Mask(0.5, jd.RoughDielectric())),
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_parameters_are_named(message):
    with pytest.raises(ValueError, match=message):
        WRONG[message]()


def test_names_of_materials():
    np.testing.assert_allclose(jd.Dielectric("Water", "vacuum").eta, 1.333, rtol=1e-6)
    np.testing.assert_allclose(jd.Dielectric().eta, 1.5046 / 1.000277, rtol=1e-6)
    gold = jd.Conductor("Au")
    reflectance = fresnel_conductor(jnp.ones(()), gold.eta, gold.k)
    assert reflectance[0] > 0.9 > reflectance[1] > reflectance[2]  # yellow
    assert isinstance(jd.TwoSided(jd.Mask(0.5, jd.Diffuse())), jd.TwoSided)


def test_models_can_be_made_inside_jit():
    """Traced parameters have no range to check."""
    up = jnp.asarray([[0.0, 0.0, 1.0]])
    value = jax.jit(lambda alpha: jd.RoughConductor(alpha).eval(up, up)[0, 0])
    np.testing.assert_allclose(value(0.2), 1 / (4 * np.pi * 0.04), rtol=1e-5)
    assert np.isfinite(jax.jit(jax.grad(lambda n: jd.Dielectric(n).sample_delta(up, up[:, :2]).weight.sum()))(1.5))


def test_glass_far_beyond_the_critical_angle():
    """Nothing is refracted, and the reflectance is one less the facets' losses."""
    glass = jd.RoughDielectric(0.01, 1.5, 1.0)
    wi = repeated(direction(np.pi - 1.2, 0.0), 2000)
    wo = call(glass, "sample", wi, uniform(2000, 0))
    density = call(glass, "pdf", wi, wo)
    assert np.all(wo[density > 0, 2] < 0)
    weight = call(glass, "eval", wi, wo)[density > 0, 0] / density[density > 0]
    np.testing.assert_allclose(weight.mean() * (density > 0).mean(), 1.0, atol=0.02)
    assert float(fresnel_dielectric(jnp.asarray(-np.cos(1.2)), glass.eta).reflectance) == 1.0
