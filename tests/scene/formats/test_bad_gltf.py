"""Damaged and hostile glTF files: one error that names file and place; nothing is run, nothing read from elsewhere."""

import json
import os
import resource
import sys
import warnings
import zlib

import numpy as np
import pytest
from PIL import EpsImagePlugin

from experiments.real_scenes.gltf_writer import CORNERS, File
from jaxdr.geometry.gltf import sizes
from jaxdr.geometry.gltf.compression import meshopt_view
from jaxdr.geometry.load import load_mesh
from jaxdr.scene.formats.gltf.load import load_gltf
from tests.fuzz.gltf_and_pictures import compressed, everything
from tests.scene.formats.bad_gltf import cube, png, refused, refused_file

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"
INSTANCING = "EXT_mesh_gpu_instancing"


# Images


@pytest.mark.parametrize(
    "data", [EPS, b"\xc5\xd0\xd3\xc6" + bytes(26) + EPS, b"GIF89a" + bytes(20), b"", b"P6\n1 1\n255\n123"]
)
def test_no_program_is_started_for_an_image(tmp_path, monkeypatch, data):
    """Pillow runs Ghostscript for EPS. Only formats that glTF names are opened."""
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: pytest.fail("a program was started"))
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: pytest.fail("a program was started"))
    file = File()
    number = file.texture(data or b"\0")
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": number}}})
    refused_file(tmp_path, file, "image 0: not a readable PNG or JPEG or WEBP")


def test_an_image_that_claims_more_pixels_than_it_has_bytes_for(tmp_path):
    data = bytearray(png())
    data[16:24] = (9000).to_bytes(4, "big") * 2
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    file = File()
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(bytes(data))}}})
    refused_file(tmp_path, file, "image 0: 9000 x 9000 pixels take more bytes, the file has ")


# Files beside the file


def beside(tmp_path, uri):
    folder = tmp_path / "models"
    (folder / "inner").mkdir(parents=True)
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    file = cube()
    path = file.save(folder / "a.gltf")
    header = json.loads(path.read_text())
    header["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(header))
    return path


@pytest.mark.parametrize("uri", ["../secret.bin", "%2e%2e/secret.bin", "inner/../../secret.bin", "/etc/hostname"])
def test_files_outside_of_the_folder_are_not_read(tmp_path, uri):
    path = beside(tmp_path, uri)
    message = refused(path, "buffer 0: ", "is outside the folder of this file; put it there, and change its URI")
    assert uri in message


def test_links_out_of_the_folder_are_not_followed(tmp_path):
    path = beside(tmp_path, "link.bin")
    (path.parent / "link.bin").symlink_to(tmp_path / "secret.bin")
    refused(path, "'link.bin' is outside the folder of this file")


def test_files_in_the_folder_and_below_are_read(tmp_path):
    for uri in ("inner/../a.bin", "inner/b.bin", "link.bin"):
        path = beside(tmp_path / uri.replace("/", "_"), uri)
        data = (path.parent / "a.bin").read_bytes()
        (path.parent / "inner" / "b.bin").write_bytes(data)
        (path.parent / "link.bin").symlink_to(path.parent / "inner" / "b.bin")
        assert list(load_gltf(path).shapes) == ["cube"]


@pytest.mark.parametrize(
    "uri",
    [
        "",
        ".",
        "inner",
        "a\0b",
        "x" * 5000,
        "file:///etc/hostname",
        "http://a/b",
        "pipe",
        "/dev/zero",
        "data:x;base64,?",
    ],
)
def test_uris_that_are_no_files_are_refused_at_once(tmp_path, uri):
    path = beside(tmp_path, uri)
    os.mkfifo(path.parent / "pipe")
    assert len(refused(path, "buffer 0: ")) < 600


# Memory


def peak(path, reader=load_gltf):
    """MiB that reading a file adds to the peak of this process, with the message."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    message = refused(path, reader=reader)
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024, message


@pytest.mark.parametrize("reader", [load_gltf, load_mesh])
@pytest.mark.parametrize("count", [3 << 20, 300_000_000, 2**53 - 1])
@pytest.mark.parametrize("where", ["indices", "POSITION", "COLOR_0", "NORMAL"])
def test_values_without_data_take_no_memory(tmp_path, where, count, reader):
    file = cube()
    primitive = file.json["meshes"][0]["primitives"][0]
    if where == "indices":
        empty = {"componentType": 5125, "count": count, "type": "SCALAR"}
        primitive["indices"] = file.add("accessors", empty)
    else:
        empty = {"componentType": 5126, "count": count, "type": "VEC3"}
        primitive["attributes"][where] = file.add("accessors", empty)
    more, message = peak(file.save(tmp_path / "a.glb"), reader)
    assert more < 100 and ("no data" in message or "this machine has" in message)


def test_few_indices_without_data_are_refused(tmp_path):
    file = cube()
    empty = {"componentType": 5125, "count": 3, "type": "SCALAR"}
    file.json["meshes"][0]["primitives"][0]["indices"] = file.add("accessors", empty)
    refused_file(tmp_path, file, "accessor 2: has no data; an extension that is not read may hold it")


def test_sparse_values_alone_are_bounded(tmp_path):
    """Without a bufferView the values are zero, but for those that are stored."""
    for count in (8, 1 << 28):
        file = cube()
        sparse = {"count": 8, "indices": {"bufferView": file.view(bytes(range(8))), "componentType": 5121}}
        sparse["values"] = {"bufferView": file.view(CORNERS.tobytes())}
        accessor = {"componentType": 5126, "count": count, "type": "VEC3", "sparse": sparse}
        file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = file.add("accessors", accessor)
        path = file.save(tmp_path / "a.glb")
        if count == 8:
            assert load_gltf(path).shapes["cube"].mesh.closed
        else:
            more, message = peak(path)
            assert more < 100 and "values have no data; the file and its buffers have" in message


def instanced(count, stored=None):
    file, attributes = File(), {}
    empty = {"componentType": 5126, "count": count, "type": "VEC3"}
    attributes["TRANSLATION"] = file.add("accessors", empty)
    if stored is not None:
        attributes["SCALE"] = file.accessor(np.ones((stored, 3), np.float32))
    file.node(name="cube", mesh=file.mesh(), extensions={INSTANCING: {"attributes": attributes}})
    file.uses(INSTANCING)
    return file


@pytest.mark.parametrize("reader", [load_gltf, load_mesh])
@pytest.mark.parametrize("count", [1000, 10_000_000])
def test_instances_without_data(tmp_path, count, reader):
    more, message = peak(instanced(count).save(tmp_path / "a.glb"), reader)
    assert more < 100 and f"node 'cube': {INSTANCING}: its {count} instances have no data" in message


def test_instances_that_are_partly_zero_are_read(tmp_path):
    assert len(load_gltf(instanced(5, stored=5).save(tmp_path / "a.glb")).shapes["cube"].mesh.faces) == 60
    refused_file(tmp_path, instanced(6, stored=5), "must be there for the same number of instances")


def test_meshes_that_are_repeated_too_often(tmp_path, monkeypatch):
    """The memory is that of all copies, and it is known before the first is made."""
    asked = []
    monkeypatch.setattr(sizes, "check_memory", lambda needed, where: asked.append((needed, where)))
    file = File()
    mesh = file.mesh()
    for _ in range(50):
        file.node(mesh=mesh)
    load_gltf(file.save(tmp_path / "a.glb"))
    assert asked == [(36 * (sizes.MAKING + 50 * sizes.KEEPING), f"{50 * 36} corners")]


def test_views_of_a_buffer_share_its_bytes(tmp_path):
    file = cube()
    file.view(bytes(20 << 20))
    size = len(file.data)
    file.json["bufferViews"] += [{"buffer": 0, "byteLength": size}] * 300
    file.json["accessors"] += [
        {"bufferView": 3 + i, "componentType": 5126, "count": 8, "type": "VEC3", "byteOffset": 0} for i in range(300)
    ]
    for i in range(300):
        attributes = {"POSITION": 0, "NORMAL": 2 + i}
        file.json["meshes"][0]["primitives"].append({"attributes": attributes, "indices": 1})
    path = file.save(tmp_path / "a.glb")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert len(load_mesh(path).faces) == 301 * 12
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1000 * 1024


def test_meshopt_counts_fit_the_bytes(monkeypatch):
    monkeypatch.setitem(sys.modules, "meshoptimizer", object())
    for mode, count in (("TRIANGLES", 10**9), ("INDICES", 10**9), ("ATTRIBUTES", 10**9)):
        with pytest.raises(ValueError, match="its 100 compressed bytes can't hold 1000000000 values of 4 bytes"):
            meshopt_view({"count": count, "byteStride": 4, "mode": mode}, bytes(100))
    for count, stride in ((0, 4), (3, 0), (3, 1 << 20)):
        with pytest.raises(ValueError, match="must be a whole number from"):
            meshopt_view({"count": count, "byteStride": stride, "mode": "ATTRIBUTES"}, bytes(100))
    with pytest.raises(ValueError, match="EXT_meshopt_compression: its data can't be decoded"):
        meshopt_view({"count": 3, "byteStride": 4, "mode": "ATTRIBUTES"}, bytes(100))


def test_draco_data_of_another_shape(tmp_path):
    pytest.importorskip("DracoPy")
    file = compressed()
    primitive = file.json["meshes"][0]["primitives"][0]
    primitive["attributes"]["TEXCOORD_0"] = primitive["attributes"]["POSITION"]
    primitive["extensions"]["KHR_draco_mesh_compression"]["attributes"]["TEXCOORD_0"] = 0
    refused_file(tmp_path, file, "KHR_draco_mesh_compression: its TEXCOORD_0 has a shape of [8, 3]")


# The container


def test_bytes_after_the_end_of_a_glb_are_told(tmp_path):
    path = cube().save(tmp_path / "a.glb")
    path.write_bytes(path.read_bytes() + b"junk")
    for reader in (load_gltf, load_mesh):
        with pytest.warns(UserWarning, match=r"a\.glb: the 4 bytes after the \d+ of the GLB are left out"):
            reader(path)


def test_chunks_that_go_beyond_the_end(tmp_path):
    path = cube().save(tmp_path / "a.glb")
    data = bytearray(path.read_bytes())
    at = data.index(b"BIN\0")
    data[at : at + 4] = b"ABCD"
    data[at - 4 : at] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)
    refused(path, f"the chunk at byte {at - 4}: has ", " of its 2147483647 bytes")


def test_nodes_that_are_visited_very_often(tmp_path):
    """Each level names the next one twice: 2^60 paths to the last."""
    file = File()
    for number in range(60):
        file.node(root=number == 0, children=[number + 1, number + 1])
    file.node(root=False, mesh=file.mesh())
    refused_file(tmp_path, file, "it has two parents")


def test_a_long_chain_of_nodes(tmp_path):
    file = File()
    for number in range(5000):
        file.node(root=number == 0, children=[number + 1])
    file.node(root=False, name="last", mesh=file.mesh())
    assert list(load_gltf(file.save(tmp_path / "a.glb")).shapes) == ["last"]


def test_the_valid_file_that_is_fuzzed_is_read(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = load_gltf(everything().save(tmp_path / "a.gltf", embed=True), ignore_unsupported=True)
    assert set(scene.shapes) == {"textured", "child", "copies", "skinned"} and len(scene.lights) == 3
