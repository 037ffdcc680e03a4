"""Derivatives of images of textured surfaces: in pixels, and where texture coordinates slide under a fixed ray.

Before a constant sky of radiance one, a single flat diffuse surface sends its reflectance: its image is that of the
texture, and the pixel filter can be integrated over it without any paths. A surface that glows has the same image.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.shared.texture_jumps import seam_jumps
from jaxdr.scene.packed import pack

SIZE = 12
RNG = np.random.default_rng(7)
PIXELS = RNG.uniform(0.2, 0.9, (5, 6, 3))
ASKEW = (1.0, -2.0, 3.0)


def scene(surface, mesh=None, position=ASKEW, pixel_filter=None):
    """A square, larger than the view (no outline in sight), with a BSDF under a sky, or an emitter in the dark."""
    mesh = jd.shapes.rectangle(4.0, 4.0) if mesh is None else mesh
    film = jd.Film(SIZE, SIZE, pixel_filter or jd.Box())
    camera = jd.Perspective(jd.look_at(position, (0, 0, 0), (0, 1, 0)), 30.0, film)
    if isinstance(surface, jd.AreaEmitter):
        return jd.Scene({"quad": jd.Shape(mesh, jd.Diffuse(0.0), surface)}, camera)
    return jd.Scene({"quad": jd.Shape(mesh, surface)}, camera, jd.ConstantEnvironment(1.0))


def along(name, change):
    """Function t -> the scene with a parameter changed by t times an array."""
    return lambda of, t: of.replace({name: of.parameters()[name] + t * jnp.asarray(change)})


def turned(of, t):
    x, y, z = of.shapes["quad"].mesh.vertices.T
    return of.replace({"quad.vertices": jnp.stack([x, jnp.cos(t) * y - jnp.sin(t) * z, jnp.sin(t) * y + z], -1)})


TRANSLATION = along("quad.vertices", (0.7, -0.4, 0.5))
CAMERA = along("camera.to_world", RNG.normal(size=(4, 4)) * [[1], [1], [1], [0]])
SURFACES = {
    "bitmap": [TRANSLATION, CAMERA, turned, along("quad.bsdf.reflectance.to_uv", RNG.normal(size=(2, 3))),
               along("quad.bsdf.reflectance.pixels", RNG.normal(size=PIXELS.shape))],
    "vertex colours": [TRANSLATION, CAMERA, along("quad.bsdf.reflectance.colors", RNG.normal(size=(36, 3)))],
    "product": [TRANSLATION, turned, along("quad.bsdf.reflectance.first.pixels", RNG.normal(size=PIXELS.shape)),
                along("quad.bsdf.reflectance.second.colors", RNG.normal(size=(36, 3)))],
    "rough metal": [TRANSLATION, CAMERA, along("quad.bsdf.alpha.pixels", RNG.uniform(size=(5, 6, 1)))],
    "normal map": [TRANSLATION, CAMERA, turned, along("quad.bsdf.normal.pixels", RNG.normal(size=PIXELS.shape))],
    "bump map": [TRANSLATION, CAMERA, turned, along("quad.bsdf.height.pixels", RNG.normal(size=(5, 6, 1))),
                 along("quad.bsdf.height.to_uv", RNG.normal(size=(2, 3))), along("quad.bsdf.scale", 1.0)],
    "blend": [TRANSLATION, turned, along("quad.bsdf.weight.pixels", RNG.normal(size=(5, 6, 1))),
              along("quad.bsdf.first.normal.pixels", RNG.normal(size=PIXELS.shape)),
              along("quad.bsdf.second.alpha_v.pixels", RNG.uniform(size=(5, 6, 1)))],
}  # fmt: skip


def surface(name):
    bitmap = jd.Bitmap(PIXELS, wrap="mirror", to_uv=[[1.3, 0.2, 0.1], [-0.1, 0.8, 0.3]])
    if name == "vertex colours":
        colors = jd.VertexColors(np.random.default_rng(8).uniform(0.2, 0.9, (36, 3)))
        return scene(jd.Diffuse(colors), jd.shapes.plane(4.0, 5))
    if name == "product":
        colors = jd.VertexColors(np.random.default_rng(8).uniform(0.2, 0.9, (36, 3)))
        return scene(jd.Diffuse(jd.Product(bitmap, colors)), jd.shapes.plane(4.0, 5))
    if name == "rough metal":
        return scene(jd.RoughConductor(jd.Bitmap(PIXELS[..., 0]), "Au", specular_reflectance=bitmap))
    if name == "normal map":
        normals = jd.Bitmap([0.5, 0.5, 0.8] + 0.4 * (PIXELS - 0.5), to_uv=[[0.6, 0.2, 0.1], [-0.1, 0.8, 0.3]])
        return scene(jd.NormalMap(normals, jd.Diffuse((0.9, 0.6, 0.3))))
    if name == "bump map":
        heights = jd.Bitmap(PIXELS[..., 1], wrap="mirror", to_uv=[[0.9, 0.2, 0.1], [-0.1, 0.8, 0.3]])
        return scene(jd.BumpMap(heights, jd.RoughConductor(0.5, "Au", alpha_v=0.25), 0.4))
    if name == "blend":
        normals = jd.Bitmap([0.5, 0.5, 0.8] + 0.4 * (PIXELS - 0.5), to_uv=[[0.6, 0.2, 0.1], [-0.1, 0.8, 0.3]])
        metal = jd.RoughConductor(0.3, "Au", alpha_v=jd.Bitmap(PIXELS[..., 1]))
        return scene(jd.Blend(jd.Bitmap(PIXELS[..., 2]), jd.NormalMap(normals, jd.Diffuse((0.9, 0.6, 0.3))), metal))
    return scene(jd.Diffuse(bitmap))


@pytest.mark.parametrize("name", SURFACES)
def test_finite_differences(name):
    """Pixel by pixel in float64, of the same random numbers: emitter samples alone depend on nothing."""
    integrator = jd.PathTracer(max_depth=2, boundary=None, sampling="emitter")
    with jax.enable_x64(True):
        of = surface(name)

        def image(times):
            changed = of
            for t, change in zip(times, SURFACES[name], strict=True):
                changed = change(changed, t)
            return jd.derivative_terms(changed, jax.random.key(2), 4, integrator)["interior"]

        count, step = len(SURFACES[name]), 1e-6
        derivative = jax.jit(lambda t, d: jax.jvp(image, (t,), (d,)))
        for axis in jnp.eye(count):
            above, below = (derivative(s * step * axis, axis)[0] for s in (1, -1))
            slope = derivative(jnp.zeros(count), axis)[1]
            np.testing.assert_allclose(slope, (above - below) / (2 * step), atol=1e-7)
            assert np.abs(slope).max() > 0.3


FRONTAL = (0, 0, 4)
FOCAL = 0.5 * SIZE / np.tan(np.deg2rad(15.0))  # pixels a unit of length at distance 1
STEPS = 16  # nodes of the quadrature a pixel and axis


def filtered(texture, shift):
    """Image of the square under a texture without `to_uv`, moved by `shift` pixels to the right on the film.

    Midpoints in each pixel, before it moves: values of the texture there, and the moved filter.
    """
    line = (np.arange(-4 * STEPS, (SIZE + 4) * STEPS) + 0.5) / STEPS
    across, down = np.meshgrid(line, line)
    uv = np.stack([across - SIZE / 2, SIZE / 2 - down], -1) / FOCAL + 0.5  # 4 units wide at distance 4
    rows = jnp.zeros(uv.size // 2, jnp.int32)
    point = jd.scene.textures.TexturePoint(jnp.asarray(uv.reshape(-1, 2)), jnp.zeros((1, 3)), jnp.zeros((1, 3), int))
    value = np.asarray(jax.tree.map(lambda leaf: leaf[None], texture).values(rows, point)).reshape(*uv.shape[:2], 3)
    offset = np.arange(SIZE)[:, None] + 0.5 - line

    def density(x):
        return np.exp(-0.5 * (x / 0.5) ** 2) / (0.5 * np.sqrt(2 * np.pi)) / STEPS

    return np.einsum("ir,rcx,jc->ijx", density(offset), value, density(offset - shift))


def means(of, change, integrator, weight, keys=12, spp=32):
    """Derivative of the weighted sum of the image: mean over keys and its error."""

    @jax.jit
    def derivative(key):
        def total(t):
            return (weight * jd.render(change(of, t), key, spp, integrator)).sum()

        return jax.jvp(total, (0.0,), (1.0,))[1]

    found = np.array([float(derivative(key)) for key in jax.random.split(jax.random.key(3), keys)])
    return found.mean(), found.std(ddof=1) / keys**0.5


RIGHT = along("quad.vertices", (1.0, 0.0, 0.0))
LOOK_LEFT = along("camera.to_world", np.outer((-1, 0, 0, 0), (0, 0, 0, 1)))
BOARD = jd.Checkerboard((0.9, 0.5, 0.2), 0.1)
WHOLE = {
    "fixed rays, mesh": (jd.Diffuse(jd.Bitmap(PIXELS)), "fixed_ray", RIGHT),
    "fixed rays, camera": (jd.Diffuse(jd.Bitmap(PIXELS)), "fixed_ray", LOOK_LEFT),
    "material points": (jd.Diffuse(jd.Bitmap(PIXELS)), "material", RIGHT),
    "a board as material points": (jd.Diffuse(BOARD), "material", RIGHT),
    "it glows": (jd.AreaEmitter(jd.Bitmap(PIXELS)), "fixed_ray", RIGHT),
    "it glows as material points": (jd.AreaEmitter(BOARD), "material", RIGHT),
}
FAST = ("a board as material points", "it glows")


@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in WHOLE]
)
def test_a_square_that_moves_across_the_view(name):
    """All terms of the derivative, through a Gaussian filter, against quadrature."""
    surface, primary, change = WHOLE[name]
    texture = surface.reflectance if isinstance(surface, jd.Diffuse) else surface.radiance
    step = 1e-3
    slope = (filtered(texture, step) - filtered(texture, -step)) / (2 * step) * FOCAL / 4
    of = scene(surface, position=FRONTAL, pixel_filter=jd.Gaussian())
    mean, error = means(of, change, jd.PathTracer(max_depth=2, primary=primary, sampling="emitter"), slope)
    exact = (slope**2).sum()
    assert error < 0.03 * exact and abs(mean - exact) < 4 * error + 2e-3 * exact, (mean / exact, error / exact)


DARK, BRIGHT = (0.1, 0.2, 0.3), (0.9, 0.6, 0.5)
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])  # turns what faces up
BORDER = 0.13  # where the UVs jump, in the middle of a pixel


def seam(of_faces=False):
    """A flat sheet whose UVs jump at x = BORDER: dark on the left, bright on the right of it. Or its faces' colours."""
    points = [[x, y, 0] for x in (-2, BORDER, 2) for y in (-2, 2)]
    faces = [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]]
    if of_faces:
        return jd.Diffuse(jd.FaceColors([DARK, DARK, BRIGHT, BRIGHT])), jd.Mesh(points, faces)
    mesh = jd.Mesh(points, faces, [[0.25, 0.5], [0.75, 0.5]], [[0] * 3, [0] * 3, [1] * 3, [1] * 3])
    return jd.Diffuse(jd.Bitmap(np.array([[DARK, BRIGHT]]), wrap="clamp")), mesh


@pytest.mark.parametrize(
    ("change", "glows", "of_faces"),
    [
        pytest.param(RIGHT, False, False, id="mesh"),
        pytest.param(RIGHT, False, True, id="faces", marks=pytest.mark.slow),
        pytest.param(LOOK_LEFT, False, False, id="camera", marks=pytest.mark.slow),
        pytest.param(RIGHT, True, False, id="it glows", marks=pytest.mark.slow),
        pytest.param(RIGHT, True, True, id="faces glow", marks=pytest.mark.slow),
    ],
)
def test_a_seam_is_a_crease(change, glows, of_faces):
    """It moves over one column of pixels, which loses what jumps times the speed, in pixels."""
    bsdf, mesh = seam(of_faces)
    of = scene(jd.AreaEmitter(bsdf.reflectance) if glows else bsdf, mesh, FRONTAL)

    @jax.jit
    def derivative(key):
        def terms(t):
            return jd.derivative_terms(change(of, t), key, 256, jd.PathTracer(max_depth=2, sampling="emitter"))

        return jax.jvp(terms, (0.0,), (1.0,))[1]

    found = [jax.device_get(derivative(key)) for key in jax.random.split(jax.random.key(4), 4)]
    creases = np.mean([f["creases"] for f in found], 0)
    column = int(SIZE / 2 + FOCAL * BORDER / 4)
    exact = np.zeros((SIZE, SIZE, 3))
    exact[:, column] = FOCAL / 4 * np.subtract(DARK, BRIGHT)
    np.testing.assert_allclose(creases.mean(0), exact.mean(0), atol=0.03 * np.abs(exact).max())
    for name in ("interior", "silhouettes", "boundary"):
        assert all(np.all(np.abs(f[name]) < 1e-5) for f in found), name


@jax.jit
def jumps_of(of):
    packed = pack(of)
    return seam_jumps(packed, jnp.arange(packed.edges.vertices.shape[0]))


def test_where_seams_are():
    """At edges whose faces have other UVs there; by how much the textures differ. Not in a mesh without a jump."""
    bsdf, mesh = seam()
    jumps = np.asarray(jumps_of(scene(bsdf, mesh)))
    at_seam = (np.asarray(mesh.vertices)[np.asarray(mesh.edges.vertices)][..., 0] == np.float32(BORDER)).all(1)
    assert at_seam.sum() == 1 and np.all(jumps[~at_seam] == 0)
    np.testing.assert_allclose(jumps[at_seam], 0.1 + np.mean(np.subtract(BRIGHT, DARK)), rtol=1e-5)
    assert np.all(np.asarray(jumps_of(scene(jd.Diffuse(jd.Bitmap(PIXELS)), jd.shapes.plane(4.0, 3)))) == 0)
    np.testing.assert_allclose(np.asarray(jumps_of(scene(*seam(of_faces=True)))), jumps, rtol=1e-5)
    # UVs that go back behind the diagonal: no seam for an image, but for normals, which follow them.
    sheet, uvs = jd.shapes.rectangle(), [[0, 0], [1, 0], [1, 0], [1, 1]]
    folded = jd.Mesh(sheet.vertices, sheet.faces, uvs, sheet.faces)
    for bsdf, seams in ((jd.Diffuse(jd.Bitmap(PIXELS)), 0), (jd.NormalMap((0.6, 0.5, 0.9), jd.Diffuse()), 1)):
        assert (np.asarray(jumps_of(scene(bsdf, folded))) > 0).sum() == seams
    # An image that is stretched more on one side: no seam for colours nor for normals, but for slopes.
    stretched = jd.Mesh(sheet.vertices, sheet.faces, [[0, 0], [1, 0], [-0.5, 1], [1, 1]], sheet.faces)
    normals, heights = jd.NormalMap((0.6, 0.5, 0.9), jd.Diffuse()), jd.Bitmap(PIXELS[..., 0])
    for bsdf, seams in ((normals, 0), (jd.BumpMap(heights, jd.Diffuse()), 1)):
        assert (np.asarray(jumps_of(scene(bsdf, stretched))) > 0).sum() == seams


def test_shadows_on_a_texture():
    """The boundary term of a shadow is that of the colour it falls on: two boards that add up to white.

    The board may have jumps: neither it nor the camera moves.
    """
    ball = jd.shapes.sphere(1, 0.4, (0.2, 0.1, 0.8))
    lamp = jd.shapes.transformed(jd.shapes.rectangle(0.5, 0.5, (0.5, 0.3, -3.0)), DOWN)
    floor = scene(jd.Diffuse(jd.Checkerboard((1.0,) * 3, 0.0, to_uv=3 * np.eye(3)[:2]))).shapes["quad"]
    of = jd.Scene(
        {"ball": jd.Shape(ball), "floor": floor, "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(20.0))},
        scene(jd.Diffuse(), position=(2, -3, 3)).camera,
    )

    @jax.jit
    def shadow(first, second):
        board = {"floor.bsdf.reflectance.color0": first, "floor.bsdf.reflectance.color1": second}

        def boundary(t):
            changed = along("ball.vertices", (1.0, 0.5, 0.0))(of.replace(board), t)
            moving = jd.Moving((True, False, False), False)
            integrator = jd.PathTracer(max_depth=2, boundary=jd.KernelDensity(0.1))
            return jd.derivative_terms(changed, jax.random.key(5), 16, integrator, moving)["boundary"]

        return jax.jvp(boundary, (0.0,), (1.0,))[1]

    black, white = jnp.zeros(3), jnp.ones(3)
    one, two, both = shadow(white, black), shadow(black, white), shadow(white, white)
    np.testing.assert_allclose(one + two, both, atol=1e-5 * np.abs(both).max())
    shares = np.abs([one, two]).sum((1, 2, 3)) / np.abs(both).sum()
    assert np.all(shares > 0.2) and np.all(shares < 0.8) and np.any((one == 0) & (two != 0)), shares


def differentiate(of, change, **settings):
    """Trace the derivative, without compiling it."""
    integrator = jd.PathTracer(max_depth=2, **settings)
    jax.eval_shape(
        lambda key: jax.jvp(lambda t: jd.render(change(of, t), key, 1, integrator), (0.0,), (1.0,)), jax.random.key(0)
    )


def test_jumps_inside_faces_that_move_are_refused():
    board = scene(jd.Diffuse(jd.Checkerboard(0.2, 0.8, to_uv=np.eye(3))), pixel_filter=jd.Gaussian())
    message = (
        r'render: quad\.bsdf\.reflectance jumps inside faces \(Checkerboard\).*; use primary="material", a bilinear'
    )
    for change in (TRANSLATION, CAMERA):
        with pytest.raises(ValueError, match=message):
            differentiate(board, change)
        differentiate(board, change, primary="material")
        differentiate(board, change, boundary=None)
    differentiate(board, along("quad.bsdf.reflectance.color0", (1.0,) * 3))
    glowing = scene(jd.AreaEmitter(jd.Checkerboard(0.2, 0.8)), pixel_filter=jd.Gaussian())
    with pytest.raises(ValueError, match=r"render: quad\.emitter\.radiance jumps inside faces \(Checkerboard\).*; use"):
        differentiate(glowing, TRANSLATION)
    differentiate(glowing, TRANSLATION, primary="material")
    differentiate(glowing, along("quad.emitter.radiance.color0", (1.0,) * 3))
    for primary in ("fixed_ray", "material"):
        with pytest.raises(ValueError, match="it has no derivative by to_uv or UVs"):
            differentiate(board, along("quad.bsdf.reflectance.to_uv", np.ones((2, 3))), primary=primary)
        tinted = jd.Product(jd.Checkerboard(0.2, 0.8, to_uv=np.eye(3)), jd.VertexColors(np.ones(4)))
        board_and_colors = scene(jd.Diffuse(tinted), pixel_filter=jd.Gaussian())
        with pytest.raises(ValueError, match="it has no derivative by to_uv or UVs"):
            change = along("quad.bsdf.reflectance.first.to_uv", np.ones((2, 3)))
            differentiate(board_and_colors, change, primary=primary)
