"""Mitsuba's half of the comparison: it reads the same file, but curved shapes have our tessellation."""

import xml.etree.ElementTree as ElementTree

import numpy as np

from experiments.forward_images.files import write_ply

CURVED = ("sphere", "disk", "cylinder")
PLACING = ("to_world", "center", "radius", "p0", "p1", "flip_normals")


def tessellated(path, scene):
    """A copy of a scene file, beside it, whose spheres, disks and cylinders are the meshes that our loader makes."""
    tree = ElementTree.parse(path)
    for element in tree.iter("shape"):
        kind = element.get("type")
        if kind not in CURVED:
            continue
        mesh, name = scene.shapes[element.get("id")].mesh, element.get("id")
        write_ply(path.with_name(f"{path.stem}_{name}.ply"), mesh)
        for child in [child for child in element if child.get("name") in PLACING]:
            element.remove(child)
        element.set("type", "ply")
        ElementTree.SubElement(element, "string", name="filename", value=f"{path.stem}_{name}.ply")
        if mesh.normal_faces is None:
            ElementTree.SubElement(element, "boolean", name="face_normals", value="true")
    copy = path.with_name(f"{path.stem}_peer.xml")
    tree.write(copy)
    return copy


def images(path, spp, seeds, variant):
    """[S, H, W, 3] independent images of a file; an LLVM variant needs an LLVM (DRJIT_LIBLLVM_PATH)."""
    import mitsuba as mi

    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_file(str(path))
    return np.stack([np.array(mi.render(scene, spp=spp, seed=seed))[..., :3] for seed in seeds])
