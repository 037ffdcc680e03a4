"""Small glTF files to be damaged, and the check that one is refused."""

import io

import pytest
from PIL import Image

from experiments.real_scenes.gltf_writer import File
from jaxdr.scene.formats.gltf.load import load_gltf


def cube(**node):
    file = File()
    file.node(name="cube", mesh=file.mesh(), **node)
    return file


def refused(path, *words, reader=load_gltf):
    """The file is refused by one ValueError that names it once, and holds these words."""
    with pytest.raises(ValueError) as caught:
        reader(path)
    message = str(caught.value)
    assert message.count(str(path)) == 1
    for part in words:
        assert part in message
    return message


def refused_file(tmp_path, file, *words, suffix=".glb"):
    refused(file.save(tmp_path / f"a{suffix}", embed=True), *words)


def png(size=(2, 2)):
    data = io.BytesIO()
    Image.new("RGB", size, (200, 100, 50)).save(data, "PNG")
    return data.getvalue()
