"""The scenes of the comparison: reference scenes with a box film, in a file that both renderers read."""

import re
import shutil
from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """One scene and the motion of one shape along x.

    `step`: half width, in scene units, of the central difference that makes the reference.
    `batches`: pairs of images, 1024 samples per pixel each, that the reference averages.
    `smooth`: interpolated normals on the moving shape instead of flat shading.
    `directly_visible`: False when only a shadow of the shape is in view: Mitsuba can leave out two of its terms.
    `max_depth`: longest path in segments. `light_scale`: size of the light, about its middle.
    """

    name: str
    folder: str
    shape: str
    step: float
    batches: int
    smooth: bool
    directly_visible: bool
    max_depth: int = 2
    light_scale: float = 1.0


CASES = {
    case.name: case
    for case in (
        Case("shadow_goathead", "shadow_goathead", "goathead", 0.02, 256, smooth=False, directly_visible=False),
        Case("direct_spot", "direct_spot", "spot", 0.001, 256, smooth=False, directly_visible=True),
        Case("direct_spot_smooth", "direct_spot", "spot", 0.001, 256, smooth=True, directly_visible=True),
        Case(
            "cornell_indirect", "cornell_indirect", "spot", 0.007, 512, smooth=False, directly_visible=True, max_depth=5
        ),
    )
}


def replaced_once(text, pattern, replacement, path):
    """`text` with the one match of `pattern` replaced; ValueError when it does not match exactly once."""
    text, count = re.subn(pattern, replacement, text, flags=re.DOTALL)
    if count != 1:
        raise ValueError(f"{path}: {pattern!r} occurs {count} times, expected once")
    return text


def resize(path, scale):
    """Scale a mesh file about the middle of its bounding box."""
    import trimesh

    mesh = trimesh.load(path, process=False)
    middle = mesh.bounds.mean(0)
    mesh.vertices = middle + scale * (mesh.vertices - middle)
    mesh.export(path)


def write_scene(case, oracle, folder):
    """Copy the scene into `folder`, with a box film and the case's normals; returns the path of the XML."""
    source = oracle / case.folder
    if not (source / "scene.xml").exists():
        raise ValueError(f"{source}: no scene.xml there; give the folder of the reference scenes with --oracle")
    text = (source / "scene.xml").read_text()
    text = replaced_once(text, r'<rfilter type="gaussian">.*?</rfilter>', '<rfilter type="box"/>', source)
    text = replaced_once(text, r'(name="sample_border" value=)"true"', r'\1"false"', source)
    if case.smooth:
        pattern = rf'(id="{case.shape}">(?:(?!</shape>).)*?name="face_normals" value=)"true"'
        text = replaced_once(text, pattern, r'\1"false"', source)
    folder.mkdir(parents=True, exist_ok=True)
    for mesh in [*source.glob("*.ply"), *source.glob("*.obj")]:
        shutil.copyfile(mesh, folder / mesh.name)
    if case.light_scale != 1.0:
        resize(folder / "light.ply", case.light_scale)
    path = folder / "scene.xml"
    path.write_text(text)
    return path
