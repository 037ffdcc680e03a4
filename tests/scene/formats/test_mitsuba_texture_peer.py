"""Textured surfaces compared with Mitsuba 3: at the same points of the same files, and as images."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.scene.packed import pack
from jaxdr.scene.scene import unwrap
from jaxdr.transport.interaction import intersect, on_fixed_ray
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.texturing import texture_point
from tests.scene.conftest import SENSOR
from tests.scene.formats.test_mitsuba_textures import COLOURED

RAYS = 40  # for each surface
RAW = '<boolean name="raw" value="true"/>'
TURN = '<rotate z="1" angle="30"/><scale x="2.5" y="1.5"/><translate x="0.3" y="-0.4"/>'
PLACE = f'<transform name="to_uv">{TURN}</transform>'


@pytest.fixture
def mitsuba():
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    yield mi
    if before is not None:
        mi.set_variant(before)


def bitmap(field, file="rgb.png", inside=""):
    precise = '<string name="format" value="variant"/>'
    return f'<texture type="bitmap" name="{field}"><string name="filename" value="{file}"/>{precise}{inside}</texture>'


def diffuse(inside):
    return f'<bsdf type="diffuse">{inside}</bsdf>'


def board(field, first, second):
    colours = f'<rgb name="color0" value="{first}"/><rgb name="color1" value="{second}"/>'
    return f'<texture type="checkerboard" name="{field}">{colours}{PLACE}</texture>'


def surfaces():
    """Name -> (type of the shape, what is inside)."""
    for wrap in ("repeat", "mirror", "clamp"):
        for kind in ("bilinear", "nearest"):
            settings = f'<string name="wrap_mode" value="{wrap}"/><string name="filter_type" value="{kind}"/>{PLACE}'
            yield f"{wrap}_{kind}", "rectangle", diffuse(bitmap("reflectance", inside=settings))
    yield "grey", "rectangle", diffuse(bitmap("reflectance", "grey.png"))
    yield "raw", "rectangle", diffuse(bitmap("reflectance", inside=RAW))
    yield "board", "rectangle", diffuse(board("reflectance", "0.9, 0.5, 0.1", "0.2, 0.3, 0.4"))
    ggx = '<string name="distribution" value="ggx"/>'
    for name, alpha in {
        "grey": bitmap("alpha", "grey.png", RAW), "luminance": bitmap("alpha"),
        "board": board("alpha", "0.6, 0.6, 0.6", "0.2, 0.2, 0.2"),
    }.items():  # fmt: skip
        yield f"alpha_{name}", "rectangle", f'<bsdf type="roughconductor">{alpha}{ggx}</bsdf>'
    roughness, metallic = bitmap("roughness", "grey.png", RAW), bitmap("metallic", "grey.png", RAW + PLACE)
    yield "principled", "rectangle", f'<bsdf type="principled">{bitmap("base_color")}{roughness}{metallic}</bsdf>'
    colours = '<texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture>'
    yield "vertices", "ply", f'<string name="filename" value="coloured.ply"/>{diffuse(colours)}'
    yield "obj", "obj", f'<string name="filename" value="seam.obj"/>{diffuse(bitmap("reflectance"))}'
    turned = '<transform name="to_world"><rotate x="1" angle="35"/><rotate z="1" angle="20"/></transform>'
    yield "cube", "cube", turned + diffuse(bitmap("reflectance"))
    normal = bitmap("normalmap", "normal.png", RAW)
    inside = diffuse('<rgb name="reflectance" value="0.8, 0.5, 0.2"/>')
    yield "normal", "rectangle", f'<bsdf type="normalmap">{normal}{inside}</bsdf>'
    yield "normal_cube", "cube", f'{turned}<bsdf type="normalmap">{normal}{inside}</bsdf>'
    mirrored = '<transform name="to_world"><scale x="1" y="-1.3"/><rotate z="1" angle="40"/></transform>'
    both = f'<bsdf type="twosided"><bsdf type="normalmap">{normal}{inside}</bsdf></bsdf>'
    yield "normal_mirrored", "rectangle", mirrored + both
    alphas = f'{bitmap("alpha_u", "grey.png", RAW)}<float name="alpha_v" value="0.2"/>{ggx}'
    two = f'<bsdf type="roughconductor">{alphas}</bsdf>'
    yield "two_cube", "cube", turned + two
    yield "two_mirrored", "rectangle", f'{mirrored}<bsdf type="twosided">{two}</bsdf>'
    yield "two_back", "rectangle", f'<boolean name="flip_normals" value="true"/><bsdf type="twosided">{two}</bsdf>'
    weight = bitmap("weight", "grey.png", RAW + PLACE)
    yield "blend", "rectangle", f'<bsdf type="blendbsdf">{weight}{inside}{two}</bsdf>'
    aniso = '<float name="anisotropic" value="0.8"/><float name="sheen" value="0.5"/>'
    yield "aniso", "rectangle", f'<bsdf type="principled">{aniso}{bitmap("roughness", "grey.png", RAW)}</bsdf>'
    yield "normal_back", "rectangle", f'<boolean name="flip_normals" value="true"/>{both}'


SURFACES = {name: rest for name, *rest in surfaces()}


@pytest.fixture
def files(tmp_path):
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (5, 6, 3), np.uint8)).save(tmp_path / "rgb.png")
    Image.fromarray(rng.integers(60, 200, (5, 6), np.uint8)).save(tmp_path / "grey.png")
    y, x = np.mgrid[0:16, 0:16] / 15
    normal = np.stack([0.6 * np.sin(6 * x), 0.5 * np.cos(9 * y), np.ones_like(x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    Image.fromarray(np.round(255 * (normal + 1) / 2).astype(np.uint8)).save(tmp_path / "normal.png")
    (tmp_path / "coloured.ply").write_text(COLOURED)


def rays(count):
    """From above towards the square [-0.45, 0.45]², and directions in which light goes on."""
    rng = np.random.default_rng(3)
    origin = rng.uniform((-1, -1, 3), (1, 1, 5), (count, 3))
    target = np.concatenate([rng.uniform(-0.45, 0.45, (count, 2)), np.zeros((count, 1))], 1)
    towards = target - origin
    out = rng.normal(size=(count, 3))
    out[:, 2] = np.abs(out[:, 2]) + 0.3
    return origin, *(v / np.linalg.norm(v, axis=1, keepdims=True) for v in (towards, out))


def test_scattering_as_in_mitsuba(mitsuba, scene_file, files):
    """BSDF times cosine for the same rays: every texture, filter and wrap, where UVs and tangents point."""
    origin, towards, out = rays(RAYS)
    expected, scenes = {}, {}
    for name, (kind, inside) in SURFACES.items():
        path = scene_file(f'{SENSOR}<shape type="{kind}" id="{name}">{inside}</shape>')
        theirs, context = mitsuba.load_file(str(path)), mitsuba.BSDFContext()
        expected[name] = []
        for o, d, w in zip(origin, towards, out, strict=True):
            hit = theirs.ray_intersect(mitsuba.Ray3f(o, d))
            expected[name].append(list(hit.bsdf().eval(context, hit, hit.to_local(w.tolist()))))
        scenes[name] = jd.load_mitsuba(path)
    # One scene of all: the surfaces in a row, far apart.
    shapes, shift = {}, {}
    for i, name in enumerate(sorted(scenes)):
        shape = scenes[name].shapes[name]
        shift[name] = np.array([16.0 * i, 0, 0])
        moved = np.eye(4)
        moved[:3, 3] = shift[name]
        shapes[name] = jd.Shape(jd.shapes.transformed(shape.mesh, moved), shape.bsdf)
    packed = pack(jd.Scene(shapes, scenes["grey"].camera))
    origins = jnp.asarray(np.concatenate([origin + shift[name] for name in shapes]), float)
    directions, outs = (jnp.asarray(np.tile(v, (len(shapes), 1)), float) for v in (towards, out))

    @jax.jit
    def scattered(packed):
        face = intersect(packed, origins, directions, jnp.ones(len(origins), bool), "jax").face
        point = on_fixed_ray(packed, origins, directions, face)
        return point.valid, Scatterer(packed, point, -directions).eval(outs)

    valid, found = (np.asarray(x).reshape(len(shapes), RAYS, -1) for x in scattered(packed))
    assert valid.all()
    for values, name in zip(found, shapes, strict=True):
        theirs = np.array(expected[name])
        assert (theirs > 0).any(1).mean() > 0.5 and np.ptp(theirs, axis=0).max() > 0.05, name
        apart = np.abs(values - theirs).max(1) / (np.abs(theirs).max(1) + 0.02)
        # float32 has 1e-5 of a coordinate near 100; UVs, and from those what lies between two pixels, no more.
        assert np.median(apart) < 1e-4 and apart.max() < 1e-3, (name, np.sort(apart)[-5:])


def test_opacity_as_in_mitsuba(mitsuba, scene_file, files):
    """Masks are not rendered yet: their opacity alone, where rays go through."""
    masked = f'<bsdf type="mask">{bitmap("opacity", "grey.png", RAW + PLACE)}{diffuse("")}</bsdf>'
    path = scene_file(f'{SENSOR}<shape type="rectangle" id="m">{masked}</shape>')
    theirs, ours = mitsuba.load_file(str(path)), jd.load_mitsuba(path).shapes["m"]
    mask = unwrap(ours.bsdf)
    opaque = jd.Shape(ours.mesh, jd.Principled(metallic=mask.opacity))
    packed = pack(jd.Scene({"m": opaque}, jd.load_mitsuba(path).camera))
    origin, towards, _ = rays(20)
    origins, directions = (jnp.asarray(v, float) for v in (origin, towards))
    face = intersect(packed, origins, directions, jnp.ones(20, bool), "jax").face
    at = texture_point(packed, on_fixed_ray(packed, origins, directions, face))
    (group,) = packed.bsdfs
    found = group.bsdf.metallic.values(jnp.zeros(20, jnp.int32), at)
    for o, d, opacity in zip(origin, towards, found, strict=True):
        hit = theirs.ray_intersect(mitsuba.Ray3f(o, d))
        np.testing.assert_allclose(1 - np.asarray(hit.bsdf().eval_null_transmission(hit))[0], opacity, atol=1e-5)


@pytest.mark.slow
def test_an_image_as_in_mitsuba(mitsuba, scene_file, files):
    """z-test of every pixel and channel over independent renderings: textured colour, roughness and normals."""
    names = {
        "principled": (-1.1, 1.1),
        "normal": (1.1, 1.1),
        "mirror_bilinear": (-1.1, -1.1),
        "alpha_luminance": (1.1, -1.1),
    }
    shapes = [
        f'<shape type="rectangle" id="{name}">{SURFACES[name][1]}'
        f'<transform name="to_world"><translate x="{x}" y="{y}"/></transform></shape>'
        for name, (x, y) in names.items()
    ]
    path = scene_file(
        '<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0, -3, 5" '
        'target="0, 0, 0" up="0, 1, 0"/></transform><film type="hdrfilm"><integer name="width" value="20"/><integer '
        'name="height" value="20"/><rfilter type="box"/></film></sensor>'
        + "".join(shapes)
        + '<shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="180"/><translate x="1" '
        'z="3"/></transform><emitter type="area"><rgb name="radiance" value="5, 6, 7"/></emitter></shape>'
        '<emitter type="constant"><rgb name="radiance" value="0.7, 0.8, 0.9"/></emitter>'
        '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
    )
    scene, count, spp = jd.load_mitsuba(path), 16, 64
    theirs = mitsuba.load_file(str(path))
    expected = np.stack([np.asarray(mitsuba.render(theirs, spp=spp, seed=i))[..., :3] for i in range(count)])
    render = jax.jit(lambda key: jd.render(scene, key, spp, jd.PathTracer(max_depth=3, boundary=None)))
    found = np.stack([np.asarray(render(key)) for key in jax.random.split(jax.random.key(0), count)])
    error = np.sqrt((expected.var(0, ddof=1) + found.var(0, ddof=1)) / count) + 1e-4
    z = (found.mean(0) - expected.mean(0)) / error
    assert z.std() < 1.3 and np.abs(z).max() < 6 and abs(z.mean()) < 0.3, (z.std(), np.abs(z).max(), z.mean())
    np.testing.assert_allclose(found.mean(), expected.mean(), rtol=3e-3)
