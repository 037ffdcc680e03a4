"""Writes scene files for Mitsuba. Each has one thing that was found in scenes of other people."""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from experiments.real_scenes.mitsuba_meshes import FACE_NORMALS, hill, ply, serialized

VIEW = '<transform name="to_world"><lookat origin="0, -4, 3" target="0, 0, 0.3" up="0, 0, 1"/></transform>'
SIZE = '<integer name="width" value="24"/><integer name="height" value="18"/>'
FILM = f'<film type="hdrfilm">{SIZE}<rfilter type="box"/></film>'
SENSOR = f'<sensor type="perspective"><float name="fov" value="45"/>{VIEW}{FILM}</sensor>'
PATH = '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
FLOOR = '<shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/></transform></shape>'
OVERHEAD = '<transform name="to_world"><rotate x="1" angle="180"/><translate x="1" z="4"/></transform>'
LAMP = (
    '<shape type="rectangle" id="lamp"><emitter type="area"><rgb name="radiance" value="8, 7, 6"/></emitter>'
    f"{OVERHEAD}</shape>"
)
ROOM = FLOOR + LAMP
LIFTED = '<transform name="to_world"><scale value="0.8"/><translate z="0.81"/></transform>'


def scene(content, *, room=ROOM, sensor=SENSOR, integrator=PATH, version="3.0.0", head='<?xml version="1.0"?>'):
    """A whole file: a floor, a lamp, a sensor, and what is to be tried."""
    return f'{head}\n<scene version="{version}">\n{integrator}\n{sensor}\n{room}\n{content}\n</scene>\n'


def ball(bsdf):
    """A sphere of this BSDF in the room."""
    return scene(f'<shape type="sphere" id="ball">\n{bsdf}\n{LIFTED}</shape>')


def mesh(kind, filename, content=""):
    """A mesh file in the room."""
    return scene(f'<shape type="{kind}" id="mesh"><string name="filename" value="{filename}"/>\n{content}</shape>')


def old(content, **others):
    """A file of Mitsuba 0.6."""
    film = f'<film type="hdrfilm">{SIZE}<float name="gamma" value="2.2"/><rfilter type="box"/></film>'
    sensor = f'<sensor type="perspective"><float name="fov" value="45"/>{VIEW.replace("to_w", "toW")}{film}</sensor>'
    room = ROOM.replace("to_world", "toWorld")
    integrator = PATH.replace("max_depth", "maxDepth").replace(
        "</", '<boolean name="strictNormals" value="true"/></', 1
    )
    return scene(content, **{"version": "0.6.0", "room": room, "sensor": sensor, "integrator": integrator} | others)


def old_ball(bsdf):
    return old(f'<shape type="sphere" id="ball">\n{bsdf}\n{LIFTED.replace("to_world", "toWorld")}</shape>')


def image(name, content="", kind="bitmap", filename="colors.png"):
    return f'<texture type="{kind}" name="{name}"><string name="filename" value="{filename}"/>{content}</texture>'


ATTRIBUTE = (
    '<bsdf type="diffuse"><texture type="mesh_attribute" name="reflectance"><string name="name" value="{}"/></texture>'
    "</bsdf>"
)
ALPHAS = '<float name="alpha_u" value="0.1"/><float name="alpha_v" value="0.4"/>'
PLAIN = '<bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.3, 0.2"/></bsdf>'
GLOSSY = '<float name="roughness" value="0.4"/><rgb name="base_color" value="0.7, 0.3, 0.2"/>'
SERIALIZED = '<integer name="shape_index" value="{}"/>'

SHAPES = {
    "serialized": mesh("serialized", "hills.serialized"),
    "serialized_index": mesh("serialized", "hills.serialized", SERIALIZED.format(1)),
    "serialized_colors": mesh("serialized", "hills.serialized", SERIALIZED.format(2)),
    "serialized_face_normal_flag": mesh("serialized", "hills.serialized", SERIALIZED.format(3)),
    "serialized_version_3_doubles": mesh("serialized", "old.serialized", SERIALIZED.format(1)),
    "serialized_flat_mirrored": mesh(
        "serialized",
        "hills.serialized",
        '<boolean name="face_normals" value="true"/><transform name="to_world"><scale x="-1" y="1" z="1"/></transform>'
        '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>',
    ),
    "serialized_textured": mesh(
        "serialized", "hills.serialized", f'{SERIALIZED.format(1)}<bsdf type="diffuse">{image("reflectance")}</bsdf>'
    ),
    "latin_1_obj": mesh("obj", "latin.obj"),
    "no_area": mesh("obj", "flat.obj"),
    "face_attribute": mesh("ply", "painted.ply", ATTRIBUTE.format("face_color")),
    "vertex_attribute": mesh("ply", "painted.ply", ATTRIBUTE.format("vertex_color")),
    "curves": scene('<shape type="bsplinecurve"><string name="filename" value="curve.txt"/></shape>'),
    "distance_grid": scene('<shape type="sdfgrid"><string name="filename" value="grid.vol"/></shape>'),
    "no_shape": scene("", room='<emitter type="constant"/>'),
    "long_axis": scene(
        '<shape type="cube"><transform name="to_world"><scale value="0.3"/><rotate x="1" y="1" angle="20"/>'
        '<translate z="1"/></transform></shape>'
    ),
    "interior_medium": ball('<medium type="homogeneous" name="interior"/><bsdf type="dielectric"/>'),
    "null_interface": ball('<bsdf type="null"/><medium type="homogeneous" name="interior"/>'),
}
SETTINGS = {
    "area_emitter_by_reference": scene(
        '<shape type="sphere"><ref id="glow"/><transform name="to_world"><scale value="0.3"/><translate z="2"/>'
        "</transform></shape>",
        room=f'<emitter type="area" id="glow"><rgb name="radiance" value="9, 8, 7"/></emitter>{FLOOR}',
    ),
    "film_by_reference": scene(
        "",
        sensor=f'<rfilter type="box" id="filter"/><film type="hdrfilm" id="film">{SIZE}<ref id="filter"/></film>'
        '<sampler type="independent" id="sampler"/><sensor type="perspective"><float name="fov" value="45"/>'
        f'{VIEW}<ref id="film"/><ref id="sampler"/></sensor>',
    ),
    "foreign_integrator": scene(
        "", integrator='<integrator type="specular_manifold"><float name="step" value="1"/></integrator>'
    ),
    "unknown_settings": scene(
        "",
        integrator=PATH.replace("</", '<boolean name="nee" value="true"/></', 1),
    ),
    "halton": scene(
        "",
        sensor=SENSOR.replace(
            "</sensor>", '<sampler type="halton"><integer name="base" value="2"/></sampler></sensor>'
        ),
    ),
    "constant_projector": scene(
        '<emitter type="projector"><rgb name="irradiance" value="2, 3, 4"/><float name="fov" value="50"/>'
        '<transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform></emitter>'
    ),
    "comment_with_dashes": scene("<!-- a -- b --->"),
    "wrong_encoding": scene("<!-- é -->", head='<?xml version="1.0" encoding="utf-8"?>'),
    "spot_with_texture": scene(
        f'<emitter type="spot"><rgb name="intensity" value="30, 30, 30"/>{image("texture")}'
        '<transform name="to_world"><lookat origin="-0.5, 0, 3.5" target="0, 0, 0" up="0, 1, 0"/></transform></emitter>'
    ),
    "sunsky": scene('<emitter type="sunsky"/>', room=FLOOR),
    "bmp_image": scene(
        f'<shape type="rectangle"><bsdf type="diffuse">{image("reflectance", filename="colors.bmp")}</bsdf>'
        '<transform name="to_world"><translate z="0.3"/></transform></shape>'
    ),
}
MATERIALS = {
    "rough_conductor_anisotropic": ball(
        f'<bsdf type="roughconductor"><string name="material" value="Cu"/>{ALPHAS}</bsdf>'
    ),
    "rough_dielectric_anisotropic": ball(f'<bsdf type="roughdielectric">{ALPHAS}</bsdf>'),
    "alpha_u_textured": ball(
        f'<bsdf type="roughconductor"><float name="alpha_v" value="0.3"/>{image("alpha_u", filename="grey.png")}</bsdf>'
    ),
    "alpha_textured": ball(f'<bsdf type="roughconductor">{image("alpha", filename="grey.png")}</bsdf>'),
    "blend": ball(
        f'<bsdf type="blendbsdf"><float name="weight" value="0.3"/>{PLAIN}<bsdf type="roughconductor"/></bsdf>'
    ),
    "blend_textured": ball(
        f'<bsdf type="blendbsdf">{image("weight", filename="grey.png")}{PLAIN}<bsdf type="plastic"/></bsdf>'
    ),
    "bump": ball(
        f'<bsdf type="bumpmap">{image("", filename="grey.png")}<float name="scale" value="0.2"/>{PLAIN}</bsdf>'
    ).replace(' name=""', ""),
    "bump_of_two_sided": ball(
        f'<bsdf type="twosided"><bsdf type="bumpmap">{image("", filename="grey.png")}{PLAIN}</bsdf></bsdf>'
    ).replace(' name=""', ""),
    "phong": ball('<bsdf type="phong"><float name="exponent" value="30"/></bsdf>'),
    "sheen": ball(
        f'<bsdf type="principled">{GLOSSY}<float name="sheen" value="0.8"/><float name="sheen_tint" value="0.5"/>'
        "</bsdf>"
    ),
    "clearcoat": ball(
        f'<bsdf type="principled">{GLOSSY}<float name="clearcoat" value="0.9"/>'
        '<float name="clearcoat_gloss" value="0.7"/></bsdf>'
    ),
    "transmission": ball(
        f'<bsdf type="principled">{GLOSSY}<float name="spec_trans" value="0.7"/><float name="eta" value="1.5"/></bsdf>'
    ),
    "anisotropic_principled": ball(f'<bsdf type="principled">{GLOSSY}<float name="anisotropic" value="0.7"/></bsdf>'),
    "flatness": ball(f'<bsdf type="principled">{GLOSSY}<float name="flatness" value="0.7"/></bsdf>'),
    "spec_tint": ball(f'<bsdf type="principled">{GLOSSY}<float name="spec_tint" value="0.7"/></bsdf>'),
    "sheet": ball(f'<bsdf type="principledthin">{GLOSSY}<float name="flatness" value="0.5"/></bsdf>'),
    "sheet_that_transmits": ball(f'<bsdf type="principledthin">{GLOSSY}<float name="diff_trans" value="1"/></bsdf>'),
    "amorphous_carbon": ball('<bsdf type="conductor"><string name="material" value="a-C"/></bsdf>'),
    "polarised_plastic": ball('<bsdf type="pplastic"/>'),
    "rgb_opacity": ball(f'<bsdf type="mask"><rgb name="opacity" value="0.5, 0.2, 0.9"/>{PLAIN}</bsdf>'),
    "one_number_spectrum": ball('<bsdf type="diffuse"><spectrum name="reflectance" value="0.3"/></bsdf>'),
}
OLD = {
    "old_serialized": old(
        '<shape type="serialized"><string name="filename" value="hills.serialized"/>'
        '<integer name="shapeIndex" value="1"/></shape>'
    ),
    "old_ext_eta": old_ball(
        '<bsdf type="roughconductor"><string name="material" value="Al"/><float name="extEta" value="1"/></bsdf>'
    ),
    "old_ext_eta_of_water": old_ball(
        '<bsdf type="conductor"><rgb name="eta" value="0.2, 0.9, 1.1"/><rgb name="k" value="3.9, 2.4, 2.2"/>'
        '<float name="extEta" value="1.33"/></bsdf>'
    ),
    "old_srgb": old_ball('<bsdf type="diffuse"><srgb name="reflectance" value="0.8, 0.4, 0.2"/></bsdf>'),
    "old_hexadecimal": old_ball('<bsdf type="diffuse"><rgb name="reflectance" value="#cc6633"/></bsdf>'),
    "old_bytes": old_ball('<bsdf type="diffuse"><rgb name="reflectance" value="200, 100, 50"/></bsdf>'),
    "old_rgb_spectrum": old_ball('<bsdf type="diffuse"><spectrum name="reflectance" value="0.5, 0.4, 0.3"/></bsdf>'),
    "old_trilinear": old_ball(
        f'<bsdf type="diffuse">{image("reflectance", """<string name="filterType" value="trilinear"/>""")}</bsdf>'
    ),
    "old_image_gamma": old_ball(
        f'<bsdf type="diffuse">{image("reflectance", """<float name="gamma" value="1"/>""")}</bsdf>'
    ),
    "old_opacity": old_ball(f'<bsdf type="mask"><rgb name="opacity" value="0.5"/>{PLAIN}</bsdf>'),
    "old_integrator": old("", integrator='<integrator type="bdpt"><integer name="maxDepth" value="3"/></integrator>'),
    "old_low_dynamic_range_film": old(
        "",
        sensor=SENSOR.replace("hdrfilm", "ldrfilm")
        .replace("to_world", "toWorld")
        .replace(SIZE, f'{SIZE}<float name="gamma" value="-1"/>'),
    ),
    "old_mixture": old_ball(
        f'<bsdf type="mixturebsdf"><string name="weights" value="0.5, 0.2"/>{PLAIN}<bsdf type="conductor"/></bsdf>'
    ),
    "old_phong": old_ball('<bsdf type="phong"><float name="exponent" value="30"/></bsdf>'),
    "old_copper": old_ball('<bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf>'),
}
CORPUS = {**SHAPES, **SETTINGS, **MATERIALS, **OLD}


def write(folder):
    """Write all files; the scenes' paths."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _write_meshes(folder)
    rng = np.random.default_rng(0)
    smooth = np.asarray(
        Image.fromarray(rng.integers(40, 230, (6, 6, 3), np.uint8)).resize((48, 48), Image.Resampling.BICUBIC)
    )
    for name, pixels in {"colors.png": smooth, "colors.bmp": smooth, "grey.png": smooth[..., 0]}.items():
        Image.fromarray(pixels).save(folder / name)
    paths = []
    for name, text in CORPUS.items():
        paths.append(folder / f"{name}.xml")
        paths[-1].write_bytes(text.encode("latin-1" if name == "wrong_encoding" else "utf-8"))
    return paths


def _write_meshes(folder):
    bump = hill()
    bare = {name: bump[name] for name in ("vertices", "faces")}
    colors = np.stack([0.2 + 0.3 * (bump["vertices"][:, 0] + 1), *2 * [0.3 * np.ones(len(bump["vertices"]))]], axis=1)
    meshes = [bare, bump, {**bare, "colors": colors}, {**bare, "flags": FACE_NORMALS}]
    (folder / "hills.serialized").write_bytes(serialized(meshes))
    (folder / "old.serialized").write_bytes(serialized([bare, bump], version=3, kind="<f8"))
    triangle = "v -1 -1 0.5\nv 1 -1 0.5\nv 0 1 0.5\nf 1 2 3\n"
    (folder / "latin.obj").write_bytes(f"# Fläche, größer\n{triangle}".encode("latin-1"))
    (folder / "flat.obj").write_text("v 0 0 1\nv 1 0 1\nv 2 0 1\nf 1 2 3\n")
    shade = np.linspace(0.1, 0.9, len(bump["faces"]))
    vertex = {f"color_{k}": ("float", colors[:, k]) for k in range(3)}
    face = {f"color_{k}": ("float", shade if k else shade[::-1]) for k in range(3)}
    (folder / "painted.ply").write_text(ply(bump["vertices"], bump["faces"], vertex, face))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    print(f"{len(write(parser.parse_args().folder))} scenes")
