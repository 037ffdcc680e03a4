"""Further layouts: poses, lenses, pictures and masks by their own formulas, and one error for damaged files."""

import re
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.images import load_image
from tests.views.folders import SIZE, disc, poses, write_picture
from tests.views.further_folders import (
    CALIBRATION,
    CENTRE,
    POINT,
    WORLD,
    F,
    K,
    llff_table,
    metashape_xml,
    middlebury_lines,
    neus_arrays,
    similarity,
    world_to_camera,
    write_llff,
    write_mask,
    write_metashape,
    write_middlebury,
    write_neus,
)


def check_cameras(views, focal=F, centre=CENTRE, expected=None):
    """Poses, focal lengths and principal points of all views."""
    for view, pose in zip(views, poses(len(views)) if expected is None else expected, strict=True):
        np.testing.assert_allclose(view.to_world, pose, atol=1e-7)
        np.testing.assert_allclose([view.focal, *view.centre], [focal, *centre], rtol=1e-7)


def pixel(projection, point) -> np.ndarray:
    """The pixel of a point, by a matrix [3, 4] or [4, 4]."""
    x, y, w = (projection @ [*point, 1.0])[:3]
    return np.array([x / w, y / w])


def seen(view, point) -> np.ndarray:
    return np.asarray(view.camera.project(jnp.asarray(point)))


# NeuS


def test_neus(tmp_path):
    views = jd.load_views(write_neus(tmp_path)).views
    check_cameras(views)
    arrays = neus_arrays()
    for i, view in enumerate(views):
        np.testing.assert_allclose(
            seen(view, POINT), pixel(arrays[f"world_mat_{i}"] @ arrays[f"scale_mat_{i}"], POINT), atol=1e-4
        )
        assert view.name == f"{i:06d}" and view.mask == tmp_path / "mask" / f"{i:03d}.png"
        np.testing.assert_array_equal(view.alpha > 0.5, disc())


def test_neus_of_another_kind(tmp_path):
    """IDR's names, matrices of three rows, masks under the names of the pictures; ten and more pictures."""
    arrays = {name: value[:3] for name, value in neus_arrays(11).items() if "inv" not in name}
    write_neus(tmp_path, 11, arrays, masks=False)
    (tmp_path / "cameras_sphere.npz").rename(tmp_path / "cameras.npz")
    (tmp_path / "image").rename(tmp_path / "images")
    for i in range(11):
        write_mask(tmp_path / "masks" / f"{i:06d}.png")
    (tmp_path / "images" / "._000000.png").write_text("of macOS")
    views = jd.load_views(tmp_path).views
    check_cameras(views)
    assert [view.mask.name for view in views] == [f"{i:06d}.png" for i in range(11)]


def test_masks_of_another_number_are_not_matched_by_order(tmp_path):
    write_neus(tmp_path)
    (tmp_path / "mask" / "002.png").unlink()
    with pytest.warns(UserWarning, match="none of the 2 masks is called like a photograph"):
        assert not jd.load_views(tmp_path).masked


def test_masks_are_matched_by_order_where_only_some_are_called_like_a_picture(tmp_path):
    """Pictures from 0 on, masks from 1 on: names would shift them by one."""
    write_neus(tmp_path, masks=False)
    for i in range(1, 4):
        write_mask(tmp_path / "mask" / f"{i:06d}.png")
    assert [view.mask.stem for view in jd.load_views(tmp_path).views] == ["000001", "000002", "000003"]


# LLFF


@pytest.mark.parametrize("place", ["images", "images_4"])
def test_llff(tmp_path, place):
    write_llff(tmp_path, place=place)
    write_picture(tmp_path / "images_8" / "IMG_0.png", size=8)
    views = jd.load_views(tmp_path).views
    check_cameras(views, centre=(SIZE / 2, SIZE / 2))
    assert [view.path.parent.name for view in views] == [place] * 3
    for view, row in zip(views, llff_table(), strict=True):
        # In LLFF's words: down, right, backwards.
        down, right, back, position, _ = row[:15].reshape(3, 5).T
        ahead = position - 2 * back + 0.3 * right + 0.1 * down
        np.testing.assert_allclose(seen(view, ahead), [SIZE / 2 + F * 0.15, SIZE / 2 + F * 0.05], atol=1e-4)


# Middlebury


def test_middlebury(tmp_path):
    views = jd.load_views(write_middlebury(tmp_path)).views
    check_cameras(views)
    for view, line in zip(views, middlebury_lines()[1:], strict=True):
        values = np.array(line.split()[1:], float)
        k, r, t = values[:9].reshape(3, 3), values[9:18].reshape(3, 3), values[18:]
        np.testing.assert_allclose(seen(view, POINT), pixel(k @ np.column_stack([r, t]), POINT), atol=1e-4)
    assert [view.name for view in views] == ["dino0001", "dino0002", "dino0003"]


def test_a_missing_picture_is_left_out(tmp_path):
    write_middlebury(tmp_path)
    (tmp_path / "dino0002.png").unlink()
    with pytest.warns(UserWarning, match="1 of 3 pictures are missing"):
        assert [view.name for view in jd.load_views(tmp_path).views] == ["dino0001", "dino0003"]


# Metashape


@pytest.mark.parametrize("suffix", ["", ".PNG"])
def test_metashape(tmp_path, suffix):
    views = jd.load_views(write_metashape(tmp_path, metashape_xml(suffix=suffix))).views
    check_cameras(views)
    for view in views:
        np.testing.assert_allclose(seen(view, POINT), pixel(K @ world_to_camera(view.to_world), POINT), atol=1e-4)
    assert [view.path.name for view in views] == ["IMG_0.PNG", "IMG_1.PNG", "IMG_2.PNG"]


@pytest.mark.parametrize("where", ["component", "chunk", "matrix"])
def test_metashape_in_its_world(tmp_path, where):
    rotation, translation, scale = WORLD
    transform = similarity(*WORLD)
    if where == "matrix":
        matrix = np.eye(4)
        matrix[:3] = np.column_stack([scale * rotation, translation])
        transform = f"<transform>{' '.join(map(str, matrix.ravel()))}</transform>"
    xml = metashape_xml(transform=transform if where == "component" else "")
    if where != "component":
        xml = xml.replace("<reference>", f"{transform}<reference>")
    expected = []
    for pose in poses(3):
        moved = np.eye(4)
        moved[:3, :3] = rotation @ pose[:3, :3]
        moved[:3, 3] = scale * rotation @ pose[:3, 3] + translation
        expected.append(moved)
    views = jd.load_views(write_metashape(tmp_path, xml)).views
    check_cameras(views, expected=expected)
    # A point of the chunk is seen where it was.
    before = pixel(K @ world_to_camera(poses(3)[1]), POINT)
    np.testing.assert_allclose(seen(views[1], scale * rotation @ POINT + translation), before, atol=1e-4)


def test_a_geographic_world_is_too_far_away(tmp_path):
    transform = similarity(WORLD[0], np.array([-2499366.4, -4256836.5, 4029217.9]), 12.0)
    with pytest.warns(UserWarning, match="more than 1000 times their extent away from the origin"):
        views = jd.load_views(write_metashape(tmp_path, metashape_xml(transform=transform))).views
    check_cameras(views)


def test_cameras_without_a_pose_are_counted_and_disabled_ones_left_out(tmp_path):
    more = '<camera id="7" sensor_id="0" label="IMG_7"/><camera id="8" sensor_id="0" label="IMG_8" enabled="0"/>'
    with pytest.warns(UserWarning, match="1 of 4 cameras have no pose and are left out: IMG_7"):
        assert len(jd.load_views(write_metashape(tmp_path, metashape_xml(cameras=more))).views) == 3


def test_labels_may_be_paths(tmp_path):
    xml = metashape_xml().replace('label="IMG_1"', r'label="C:\photos\IMG_1.PNG"')
    check_cameras(jd.load_views(write_metashape(tmp_path, xml)).views)


def of_metashape(direction, kind, f, cx, cy, b1=0.0, k1=0.0, k2=0.0, k3=0.0, k4=0.0, p1=0.0, p2=0.0):
    """The pixel of a direction by the formulas of Metashape's manual."""
    x, y = direction[0] / direction[2], direction[1] / direction[2]
    if kind == "fisheye":
        radius = np.hypot(x, y)
        x, y = x * np.arctan(radius) / radius, y * np.arctan(radius) / radius
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    along_x = x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    along_y = y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    return SIZE / 2 + cx + along_x * (f + b1), SIZE / 2 + cy + along_y * f


@pytest.mark.parametrize(
    ("kind", "model", "values"),
    [
        ("frame", "OPENCV", {"k1": -0.12, "k2": 0.03}),
        ("frame", "OPENCV", {"k1": -0.1, "p1": 0.02, "p2": -0.01, "b1": 0.8}),
        ("frame", "FULL_OPENCV", {"k1": -0.1, "k2": 0.05, "k3": -0.02, "p1": 0.01, "p2": 0.004}),
        ("frame", "FULL_OPENCV", {"k1": -0.09, "k2": -0.07, "k3": 0.11, "k4": -0.076, "p1": -0.003, "p2": 0.001}),
        ("fisheye", "OPENCV_FISHEYE", {"k1": 0.05, "k2": -0.02, "k3": 0.01, "k4": -0.003}),
        ("fisheye", "THIN_PRISM_FISHEYE", {"k1": 0.05, "k2": -0.02, "k3": 0.01, "k4": 0.02, "p1": 0.01, "p2": -0.02}),
    ],
)
def test_lenses_of_metashape(tmp_path, kind, model, values):
    pytest.importorskip("pycolmap")
    calibration = CALIBRATION | values
    views = jd.load_views(write_metashape(tmp_path, metashape_xml(calibration=calibration, kind=kind))).views
    lens = views[0].lens
    assert lens.model == model
    for direction in ([0.3, -0.2, 1.0], [-0.15, 0.32, 1.0], [0.05, 0.28, 1.0], [-0.3, -0.3, 1.0]):
        expected = of_metashape(direction, kind, **calibration)
        tolerance = 1e-3 if "k4" in values and kind == "frame" else 1e-9  # a fit
        np.testing.assert_allclose(lens.project(np.array([direction])), [expected], atol=tolerance)


def test_a_strong_k4_is_fitted_out_to_the_corner(tmp_path):
    """Numbers of a drone, whose k4 moves the corner by a hundred pixels."""
    pytest.importorskip("pycolmap")
    from jaxdr.views.layouts.metashape_lens import lens_of
    from jaxdr.xml_file import Node

    values = {"f": 3705.47, "cx": 11.67, "cy": -27.75, "b1": 0.526, "k1": -0.0919, "k2": -0.0763, "k3": 0.1163}
    values |= {"k4": -0.0761, "p1": -0.00031, "p2": 0.000116}
    nodes = [Node(name, {}, str(value)) for name, value in values.items()]
    calibration = Node("calibration", {}, "", [*nodes, Node("resolution", {"width": "5280", "height": "3956"})])
    lens = lens_of(Node("sensor", {}, "", [calibration]), "a lens")
    for direction in np.random.default_rng(0).uniform([-0.72, -0.54, 1], [0.72, 0.54, 1], (200, 3)):
        u, v = of_metashape(direction, "frame", **values)
        expected = u - SIZE / 2 + 5280 / 2, v - SIZE / 2 + 3956 / 2
        np.testing.assert_allclose(lens.project(direction[None])[0], expected, atol=0.1)


# Damage


def changed(name, value):
    """NeuS with another array; none for None."""

    def write(folder):
        arrays = {**neus_arrays(), name: value}
        write_neus(folder, arrays={key: array for key, array in arrays.items() if array is not None})

    return write


def skewed(by):
    matrix = neus_arrays()["world_mat_1"] @ neus_arrays()["scale_mat_1"]
    bent = K.copy()
    bent[0, 1] = by
    return np.vstack(
        [(bent @ np.linalg.inv(K) @ matrix[:3]) @ np.linalg.inv(neus_arrays()["scale_mat_1"]), [0, 0, 0, 1]]
    )


def llff(change):
    def write(folder):
        table = llff_table()
        write_llff(folder, table=change(table))

    return write


def put(table, row, column, value):
    table[row, column] = value
    return table


def middlebury(change):
    return lambda folder: write_middlebury(folder, change(middlebury_lines()))


def word(lines, row, column, value):
    words = lines[row].split()
    words[column] = value
    return [*lines[:row], " ".join(words), *lines[row + 1 :]]


def metashape(old="", new="", **values):
    def write(folder):
        xml = metashape_xml(**values)
        assert old in xml
        write_metashape(folder, xml.replace(old, new))

    return write


def calibrated(**values):
    return metashape(calibration=CALIBRATION | values)


def broken(write, name, content):
    def damage(folder):
        write(folder)
        (folder / name).write_bytes(content)

    return damage


def pickled(folder):
    write_neus(folder)
    np.savez(folder / "cameras_sphere.npz", world_mat_0=np.array([{"a": 1}], dtype=object))


DEEP = b'<document version="1"><chunk>' + b"<a>" * 99
ENTITY = b'<!DOCTYPE a [<!ENTITY b "cc">]><document version="1"><chunk>&b;</chunk></document>'

BAD = {
    "neus: nan": (changed("world_mat_1", np.full((4, 4), np.nan)), "sphere.npz: world_mat_1: has numbers that are not"),
    "neus: infinity": (changed("scale_mat_2", np.full((4, 4), np.inf)), "scale_mat_2: has numbers that are not finite"),
    "neus: shape": (changed("world_mat_1", np.eye(3)), r"world_mat_1: expected numbers of shape [4, 4] or [3, 4], got"),
    "neus: text": (changed("world_mat_0", np.full((4, 4), "a")), "world_mat_0: expected numbers of shape"),
    "neus: complex": (changed("world_mat_0", np.eye(4) * 1j), "got [4, 4] of complex128; export the cameras anew"),
    "neus: no scale": (changed("scale_mat_1", None), "has no scale_mat_1; every picture needs world_mat and scale_mat"),
    "neus: one fewer": (changed("world_mat_2", None), "has 2 matrices world_mat_0, world_mat_1, …"),
    "neus: singular": (changed("world_mat_0", np.zeros((4, 4))), "world_mat_0: the projection is singular"),
    "neus: skew": (changed("world_mat_1", skewed(2.0)), "world_mat_1: the pixels are skewed by 0.095"),
    "neus: objects": (pickled, "cameras_sphere.npz: not a readable NPZ file"),
    "neus: no archive": (broken(write_neus, "cameras_sphere.npz", b"PK no"), "cameras_sphere.npz: not a readable NPZ"),
    "neus: empty": (broken(write_neus, "cameras_sphere.npz", b""), "cameras_sphere.npz: not a readable NPZ file"),
    "neus: one more picture": (
        lambda folder: write_picture(write_neus(folder) / "image" / "000003.png"),
        "has 3 matrices world_mat_0, world_mat_1, …",
    ),
    "llff: nan": (llff(lambda t: put(t, 1, 3, np.nan)), "poses_bounds.npy: row 1: has numbers that are not finite"),
    "llff: columns": (llff(lambda t: t[:, :14]), "row 0: expected numbers of shape [15], got [12]"),
    "llff: a vector": (llff(lambda t: t[0]), "poses_bounds.npy: expected an array of shape [N, 17], got [17]"),
    "llff: rows": (llff(lambda t: t[:2]), "poses_bounds.npy: has 2 rows, "),
    "llff: size": (llff(lambda t: put(t, 0, 4, 31.5)), "row 0: height and width must be whole numbers of pixels"),
    "llff: huge": (llff(lambda t: put(t, 0, 9, 1e12)), "row 0: height and width: must be a finite number from 1 to"),
    "llff: another shape": (llff(lambda t: put(t, 0, 4, 64)), "row 0: says width 32, IMG_0.png has 16 pixels"),
    "llff: focal": (llff(lambda t: put(t, 0, 14, -3.0)), "row 0: the focal length must be from"),
    "llff: scale": (llff(lambda t: t * 2), "row 0: the pose must be a rotation and a translation"),
    "llff: no array": (broken(write_llff, "poses_bounds.npy", b"\x93NUMPY\1"), "poses_bounds.npy: not a readable NPY"),
    "middlebury: count": (middlebury(lambda n: ["7", *n[1:]]), "line 1 must be the number of pictures, and 3 follow"),
    "middlebury: no count": (middlebury(lambda n: n[1:]), "line 1 must be the number of pictures, and 2 follow"),
    "middlebury: empty": (middlebury(lambda n: []), "line 1 must be the number of pictures"),
    "middlebury: cut": (middlebury(lambda n: [*n[:3], n[3][:99]]), "par.txt: line 4: expected 21 numbers, got"),
    "middlebury: word": (middlebury(lambda n: word(n, 2, 5, "1_0")), "line 3: expected a number, got '1_0'"),
    "middlebury: nan": (middlebury(lambda n: word(n, 2, 21, "nan")), "line 3: must be a finite number"),
    "middlebury: mirror": (middlebury(lambda n: word(n, 1, 18, "-2")), "line 2: the pose must be a rotation"),
    "middlebury: k": (middlebury(lambda n: word(n, 1, 9, "2")), "line 2: a calibration has zeros below its diagonal"),
    "middlebury: twice": (middlebury(lambda n: word(n, 1, 0, "dino0002.png")), "2 lines are of the picture 'dino0002"),
    "middlebury: utf-8": (
        broken(write_middlebury, "dino_par.txt", b"\xff\xfe9"),
        "dino_par.txt: can't be read as text",
    ),
    "middlebury: two": (
        broken(write_middlebury, "a_par.txt", b"1"),
        "has several files of cameras, a_par.txt, dino_par",
    ),
    "metashape: xml": (metashape("</chunk>", ""), "cameras.xml: is not readable XML (mismatched tag"),
    "metashape: entities": (broken(write_metashape, "cameras.xml", ENTITY), "line 1: <!DOCTYPE> with entities or an"),
    "metashape: deep": (broken(write_metashape, "cameras.xml", DEEP), "elements are nested more than 64 levels deep"),
    "metashape: word": (metashape("<transform>", "<transform>x"), "camera 'IMG_0': expected a number, got 'x"),
    "metashape: nan": (metashape("<transform>", "<transform>nan "), "camera 'IMG_0': expected 16 numbers, got 17"),
    "metashape: last row": (metashape("0 0 0 1</t", "0 0 0 2</t"), "the last row of its transform must be 0 0 0 1"),
    "metashape: none": (metashape("transform", "x"), "has no camera with a pose; align the photographs"),
    "metashape: label": (metashape("label", "name"), "camera 0 has no label or no sensor_id"),
    "metashape: sensor": (metashape('<sensor id="0"', '<sensor id="1"'), "cameras have the sensor '0', which is not"),
    "metashape: twice": (metashape('"IMG_1"', '"a/IMG_0"'), "2 cameras have the picture 'IMG_0.PNG'; rename"),
    "metashape: components": (metashape('component_id="0" label="IMG_1"', 'label="IMG_1"'), "are in 2 components"),
    "metashape: chunks": (metashape("</chunk>", "</chunk><chunk/>"), "has 2 chunks; export the cameras of one"),
    "metashape: world": (metashape(transform=similarity(*WORLD[:2], 0.0)), "must be a rotation, a translation and a"),
    "metashape: old": (metashape("f>", "fx>"), "sensor '0': has no focal length f (old PhotoScan: fx)"),
    "metashape: f": (calibrated(f=-3.0), "sensor '0': f must be at least one pixel, got -3"),
    "metashape: f nan": (calibrated(f=float("nan")), "sensor '0': f: must be a finite number"),
    "metashape: spherical": (metashape(kind="spherical"), "sensor '0': a 'spherical' camera is not supported"),
    "metashape: skew": (calibrated(b2=2.0), "sensor '0': b2 (skew) must be zero, it moves pixels by"),
    "metashape: p3": (calibrated(p1=0.1, p3=2.0), "sensor '0': p3 and p4 must be zero"),
    "metashape: folds": (calibrated(k1=-9.0, k4=0.1), "sensor '0': the distortion folds inside of the picture"),
    "metashape: size": (metashape('width="16"', 'width="-1"'), "sensor '0': must be a finite number from 1 to"),
    "metashape: no size": (metashape("resolution", "size"), "sensor '0': has no resolution"),
    "metashape: no lens": (metashape("calibration", "lens"), "sensor '0': has no calibration; align"),
    "metashape: two": (
        broken(write_metashape, "more.xml", metashape_xml().encode()),
        "has several exports of cameras, cameras.xml, more.xml; keep one",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_damaged_files(tmp_path, name):
    write, message = BAD[name]
    write(tmp_path)
    with warnings.catch_warnings(), pytest.raises(ValueError, match=re.escape(message)) as refused:
        warnings.simplefilter("error")
        jd.load_views(tmp_path)
    assert str(refused.value).startswith(str(tmp_path))


@pytest.mark.parametrize("place", ["image", "mask"])
def test_names_whose_order_is_not_that_of_their_numbers(tmp_path, place):
    write_neus(tmp_path, 11)
    for i, path in enumerate(sorted((tmp_path / place).iterdir())):
        path.rename(path.with_name(f"frame{i}.png"))
    with pytest.raises(ValueError, match=r"frame10\.png comes before|comes before frame2\.png by name"):
        jd.load_views(tmp_path)


def test_other_xml_is_no_export(tmp_path):
    write_middlebury(tmp_path)
    (tmp_path / "scene.xml").write_text('<scene version="3.0.0"/>')
    (tmp_path / "broken.xml").write_bytes(b"\0\1<document>")
    assert len(jd.load_views(tmp_path).views) == 3


def test_the_first_picture_is_the_first(tmp_path):
    views = jd.load_views(write_neus(tmp_path)).views
    for i, view in enumerate(views):
        np.testing.assert_allclose(view.image, load_image(tmp_path / "image" / f"{i:06d}.png"), rtol=1e-6)


@pytest.mark.parametrize("layout", ["llff", "metashape"])
def test_height_is_not_width(tmp_path, layout):
    """Pictures without their last four rows."""
    if layout == "llff":
        write_llff(tmp_path, table=put(llff_table(), slice(None), 4, 2 * 12))
        centre = SIZE / 2, 6.0
    else:
        write_metashape(tmp_path, metashape_xml().replace('height="16"', 'height="12"'))
        centre = CENTRE[0], CENTRE[1] - 2  # offsets are from the middle
    for path in (tmp_path / "images").iterdir():
        Image.fromarray(np.full((12, SIZE, 3), 128, np.uint8)).save(path)
    check_cameras(jd.load_views(tmp_path).views, centre=centre)
