"""Loaded shapes, cameras and lights compared with those Mitsuba itself makes of the same file."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.formats.mitsuba.load import load_mitsuba

SENSOR = '<sensor type="perspective"><float name="fov" value="40"/></sensor>'


@pytest.fixture
def mitsuba():
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    yield mi
    if before is not None:
        mi.set_variant(before)


MIRROR = '<transform name="to_world"><rotate x="1" angle="20"/><scale value="-2, 2, 2"/></transform>'
SHAPES = {
    "rectangle": ("rectangle", ""),
    "cube": ("cube", ""),
    "sphere": ("sphere", '<point name="center" value="0.2, 0, 0"/><float name="radius" value="1.5"/>'),
    "obj": ("obj", '<string name="filename" value="a.obj"/>'),
    "flat obj": ("obj", '<string name="filename" value="a.obj"/><boolean name="face_normals" value="true"/>'),
    "ply": ("ply", '<string name="filename" value="a.ply"/>'),
    "disk": ("disk", ""),
    "cylinder": (
        "cylinder",
        '<point name="p0" value="-1, 0, 0"/><point name="p1" value="1, 0.4, 0.3"/><float name="radius" value="0.8"/>',
    ),
    "obj with a seam": ("obj", '<string name="filename" value="seam.obj"/>'),
    "obj with normals": ("obj", '<string name="filename" value="normals.obj"/>'),
}


@pytest.mark.parametrize("flip", [False, True], ids=["", "flipped"])
@pytest.mark.parametrize("transform", ["", MIRROR], ids=["", "mirrored"])
@pytest.mark.parametrize("kind, content", SHAPES.values(), ids=SHAPES)
def test_shapes_as_in_mitsuba(mitsuba, scene_file, kind, content, transform, flip):
    """Vertices, and where a ray meets the shape the shading normal and the UVs."""
    flipped = '<boolean name="flip_normals" value="true"/>' if flip else ""
    path = scene_file(f'{SENSOR}<shape type="{kind}" id="s">{content}{transform}{flipped}</shape>')
    (theirs,) = mitsuba.load_file(str(path)).shapes()
    mesh = load_mitsuba(path).shapes["s"].mesh
    vertices = np.asarray(mesh.vertices)
    if kind in ("obj", "ply", "cube"):
        expected = np.unique(np.round(np.reshape(mitsuba.traverse(theirs)["vertex_positions"], (-1, 3)), 4), axis=0)
        np.testing.assert_allclose(np.unique(np.round(vertices, 4), axis=0), expected, atol=2e-4)
    box = theirs.bbox()
    np.testing.assert_allclose([vertices.min(0), vertices.max(0)], [box.min, box.max], atol=1e-2)

    origin, direction = np.array([0.1, 0.3, 5.0]), np.array([0.02, 0.01, -1.0])
    direction /= np.linalg.norm(direction)
    hit = mitsuba.load_dict({"type": "scene", "s": theirs}).ray_intersect(mitsuba.Ray3f(origin, direction))
    face, weights = first_hit(mesh, origin, direction)
    corners = vertices[np.asarray(mesh.faces)[face]]
    if mesh.normal_faces is None:
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    else:
        normal = weights @ np.asarray(mesh.vertex_normals())[np.asarray(mesh.normal_faces)[face]]
    assert np.dot(normal / np.linalg.norm(normal), hit.sh_frame.n) > 0.99
    np.testing.assert_allclose(weights @ corners, hit.p, atol=1e-2)
    if mesh.uvs is not None:
        u, v = weights @ np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)[face]]
        turns = np.array([u, 1 - v]) - hit.uv  # Mitsuba counts v from an image's top
        np.testing.assert_allclose(turns - np.round(turns), 0, atol=5e-3)


def test_uvs_of_all_sides_of_a_cube_as_in_mitsuba(mitsuba, scene_file):
    path = scene_file(f'{SENSOR}<shape type="cube" id="s"/>')
    theirs = mitsuba.traverse(mitsuba.load_file(str(path)).shapes()[0])
    positions, uvs = np.reshape(theirs["vertex_positions"], (-1, 3)), np.reshape(theirs["vertex_texcoords"], (-1, 2))
    corners = np.concatenate([positions, uvs * (1, -1) + (0, 1)], 1)  # four a side
    expected = {frozenset(map(tuple, side)) for side in corners.reshape(6, 4, 5).tolist()}
    mesh = load_mitsuba(path).shapes["s"].mesh
    ours = np.concatenate([mesh.vertices[mesh.faces], mesh.uvs[mesh.uv_faces]], -1)
    assert {frozenset(map(tuple, side)) for side in ours.reshape(6, 6, 5).tolist()} == expected


def first_hit(mesh, origin, direction):
    """Face and barycentric coordinates of the closest hit, by solving for every triangle."""
    triangles = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)]
    hits = []
    for face, corners in enumerate(triangles):
        system = np.vstack([np.column_stack([corners.T, -direction]), [1, 1, 1, 0]])
        if abs(np.linalg.det(system)) > 1e-12:
            *weights, distance = np.linalg.solve(system, [*origin, 1])
            if min(weights) >= -1e-6 and distance > 0:
                hits.append((distance, face, np.array(weights)))
    return min(hits)[1:]


CAMERAS = {
    "fov x": '<float name="fov" value="40"/>',
    "fov y": '<float name="fov" value="40"/><string name="fov_axis" value="y"/>',
    "fov smaller": '<float name="fov" value="40"/><string name="fov_axis" value="smaller"/>',
    "fov larger": '<float name="fov" value="40"/><string name="fov_axis" value="larger"/>',
    "fov diagonal": '<float name="fov" value="40"/><string name="fov_axis" value="diagonal"/>',
    "focal length": '<string name="focal_length" value="35mm"/>',
    "neither": "",
    "lookat": '<transform name="to_world"><lookat origin="1, 2, 3" target="0, 0.5, 0" up="0, 0, 1"/></transform>',
    "lookat without up": '<transform name="to_world"><lookat origin="1, 2, 3" target="0, 0.5, 0"/></transform>',
    "chained": (
        '<transform name="to_world"><rotate z="1" angle="10"/><translate value="1, 2, 3"/><scale value="-1"/>'
        '<matrix value="0 1 0 0 1 0 0 0 0 0 1 2 0 0 0 1"/></transform>'
    ),
    "turned": '<transform name="to_world"><rotate y="1" angle="30"/><translate z="2"/></transform>',
    "principal point": (
        '<float name="fov" value="40"/><float name="principal_point_offset_x" value="0.2"/>'
        '<float name="principal_point_offset_y" value="-0.15"/>'
    ),
}
LENS = '<float name="aperture_radius" value="0.2"/>'
TURNED = '<transform name="to_world">%s<rotate y="1" angle="30"/><translate z="2"/></transform>'
CAMERAS = {name: ("perspective", content) for name, content in CAMERAS.items()} | {
    "lens": ("thinlens", f'{LENS}<float name="focus_distance" value="3"/>{TURNED % ""}'),
    "lens focused on the far plane": ("thinlens", f'{LENS}<float name="fov" value="40"/>'),
    "parallel": ("orthographic", ""),
    "parallel, scaled": ("orthographic", TURNED % '<scale x="3" y="2"/>'),
    "clipped": ("thinlens", f'{LENS}<float name="near_clip" value="2"/><float name="far_clip" value="5"/>'),
}


@pytest.mark.parametrize("crop", [(0, 0, 1, 1), (0.2, 0.1, 0.5, 0.6)], ids=["", "cropped"])
@pytest.mark.parametrize("size", [(30, 20), (20, 30)], ids=["wide", "tall"])
@pytest.mark.parametrize("kind, content", CAMERAS.values(), ids=CAMERAS)
def test_camera_rays_as_in_mitsuba(mitsuba, scene_file, kind, content, size, crop):
    window = np.round(np.multiply(crop, [*size, *size])).astype(int)
    names = ("width", "height", "crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
    settings = [f'<integer name="{n}" value="{v}"/>' for n, v in zip(names, (*size, *window), strict=True)]
    film = f'<film type="hdrfilm">{"".join(settings)}</film>'
    path = scene_file(f'<sensor type="{kind}">{content}{film}</sensor><shape type="cube"/>')
    (sensor,) = mitsuba.load_file(str(path)).sensors()
    camera = load_mitsuba(path).camera
    assert camera.film.window == tuple(window)
    shares = np.array([[0.0, 0.0], [1.0, 0.0], [0.3, 0.9], [1.0, 1.0]])  # of the window
    lens = np.array([[0.5, 0.5], [0.1, 0.3], [0.7, 0.05], [1.0, 0.6]])
    view = camera.view(jnp.asarray(lens, jnp.float32))
    origin, directions = view.rays(jnp.asarray(window[:2] + shares * window[2:], jnp.float32))
    starts, reaches = view.clipped(origin, directions)
    for share, u, *ours in zip(shares, lens, starts, directions, reaches, strict=True):
        ray, _ = sensor.sample_ray(0.0, 0.5, share, u)
        for mine, theirs in zip(ours, (ray.o, ray.d, ray.maxt), strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=2e-6, atol=2e-6)


def test_crop_and_light_as_in_mitsuba(mitsuba, scene_file):
    path = scene_file(
        '<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="40"/>'
        '<integer name="crop_offset_x" value="3"/><integer name="crop_width" value="20"/></film></sensor>'
        '<shape type="cube" id="l"><emitter type="area"><spectrum name="radiance" value="2"/></emitter></shape>'
    )
    theirs, ours = mitsuba.load_file(str(path)), load_mitsuba(path)
    film = theirs.sensors()[0].film()
    assert ours.camera.film.crop == (*film.crop_offset(), *film.crop_size())
    light = theirs.shapes()[0].emitter()
    radiance = mitsuba.traverse(light)["radiance.value"]
    np.testing.assert_allclose(ours.shapes["l"].emitter.radiance, radiance, rtol=1e-3)


def test_an_image_as_in_mitsuba(mitsuba, scene_file, tmp_path):
    """Every shape, instances, included and referenced materials, chained transforms, a crop window: one image."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "materials.xml").write_text(
        """<scene version="3.0.0"><default name="red" value="0.7"/>
        <bsdf type="twosided" id="clay"><ref id="clay front"/></bsdf>
        <bsdf type="diffuse" id="clay front"><rgb name="reflectance" value="$red, 0.3, 0.2"/></bsdf></scene>"""
    )
    path = scene_file(
        """<path value="parts"/><include filename="materials.xml"/><alias id="clay" as="brick"/>
        <sensor type="perspective"><float name="fov" value="45"/>
            <transform name="to_world"><lookat origin="0, -7, 4" target="0, 0, 0.5" up="0, 0, 1"/></transform>
            <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/>
                <integer name="crop_offset_x" value="4"/><integer name="crop_width" value="40"/>
                <boolean name="sample_border" value="true"/><rfilter type="tent"/></film></sensor>
        <shape type="rectangle"><ref id="brick"/><transform name="to_world"><scale value="4"/></transform></shape>
        <shape type="sphere"><point name="center" value="-2, 0, 0.7"/><float name="radius" value="0.7"/></shape>
        <shape type="cylinder"><ref id="clay"/><point name="p0" value="0, 0, 0"/><point name="p1" value="0.2, 0, 1.5"/>
            <float name="radius" value="0.5"/></shape>
        <shape type="disk"><emitter type="area"><rgb name="radiance" value="4, 6, 8"/></emitter>
            <transform name="to_world"><rotate x="1" angle="180"/><translate x="1" z="4"/></transform></shape>
        <shape type="shapegroup" id="pair">
            <shape type="cube"><transform name="to_world"><scale value="0.3"/></transform><ref id="clay"/></shape>
            <shape type="obj"><string name="filename" value="seam.obj"/>
                <bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
                <transform name="to_world"><scale value="0.8"/><translate z="1"/></transform></shape></shape>
        <shape type="instance"><ref id="pair"/><transform name="to_world"><translate x="2" z="0.3"/></transform></shape>
        <shape type="instance"><ref id="pair"/><transform name="to_world"><rotate z="1" angle="40"/>
            <scale x="-0.8" y="1" z="1.5"/><translate x="1" y="-2" z="0.5"/></transform></shape>
        <emitter type="constant"><rgb name="radiance" value="0.3, 0.25, 0.2"/></emitter>
        <integrator type="path"><integer name="max_depth" value="2"/></integrator>"""
    )
    theirs = mitsuba.load_file(str(path), red="0.9")
    expected = np.asarray(mitsuba.render(theirs, spp=256, seed=1))[..., :3]
    scene = load_mitsuba(path, red=0.9)
    image = jd.render(scene, jax.random.key(0), spp=256, integrator=jd.PathTracer(max_depth=2, boundary=None))
    assert image.shape == expected.shape == (32, 40, 3)
    difference = np.abs(np.asarray(image) - expected).mean(-1)
    np.testing.assert_allclose(np.asarray(image).mean((0, 1)), expected.mean((0, 1)), rtol=0.01)
    assert np.quantile(difference, 0.99) < 0.06 and difference.mean() < 0.02, (difference.mean(), difference.max())
