"""Scenes as Mitsuba XML. Together they use every feature of the loader."""

import dataclasses

from experiments.forward_images.markup import (
    area,
    at,
    bitmap,
    board,
    bsdf,
    diffuse,
    emitter,
    film,
    lamp,
    mesh,
    number,
    rgb,
    row,
    sensor,
    shape,
    spectrum,
    text,
    to_world,
    yes,
)


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene: the content of <scene>, the longest path in segments, and paths per pixel of each independent image.

    `differs`: whether its images differ on purpose; `note` says why.
    """

    content: str
    max_depth: int = 3
    spp: int = 128
    note: str = ""
    differs: bool = False

    @property
    def xml(self):
        """The scene file. Mitsuba's roulette is off: its noise would be another."""
        integrator = f'<integer name="max_depth" value="{self.max_depth}"/><integer name="rr_depth" value="1000"/>'
        return f'<scene version="3.0.0">\n<integrator type="path">{integrator}</integrator>\n{self.content}\n</scene>\n'


GGX = text("distribution", "ggx")
FLOOR = shape("rectangle", "floor", to_world('<scale value="4"/>'), diffuse("0.6, 0.5, 0.4"))
SKY = emitter("constant", rgb("radiance", "0.4, 0.5, 0.6"))
BOARD = shape("rectangle", "floor", to_world('<scale value="4"/>'), bsdf("diffuse", board("reflectance")))
ENVIRONMENT = emitter(
    "envmap", text("filename", "sky.pfm"), number("scale", 0.9), to_world('<rotate x="1" angle="90"/>')
)
TURN = '<rotate z="1" angle="30"/>'


def _room():
    """A closed box with a lamp, seen through its front side, which faces away."""
    sides = {
        "floor": ("", "0.7, 0.7, 0.7"),
        "ceiling": ('<rotate x="1" angle="180"/><translate z="2"/>', "0.7, 0.7, 0.7"),
        "back": ('<rotate x="1" angle="90"/><translate y="1" z="1"/>', "0.7, 0.7, 0.7"),
        "left": ('<rotate y="1" angle="90"/><translate x="-1" z="1"/>', "0.63, 0.06, 0.05"),
        "right": ('<rotate y="1" angle="-90"/><translate x="1" z="1"/>', "0.14, 0.45, 0.09"),
    }
    walls = [shape("rectangle", name, to_world(steps), diffuse(color)) for name, (steps, color) in sides.items()]
    light = '<scale value="0.4"/><rotate x="1" angle="180"/><translate z="1.98"/>'
    boxes = [
        shape("cube", "low", to_world(f'<scale value="0.3"/>{TURN}<translate x="0.35" y="-0.3" z="0.3"/>'), diffuse()),
        shape(
            "cube",
            "high",
            to_world(
                '<scale x="0.3" y="0.3" z="0.6"/><rotate z="1" angle="-20"/><translate x="-0.35" y="0.2" z="0.6"/>'
            ),
            diffuse(),
        ),
    ]
    view = sensor(origin="0, -4.2, 1", target="0, 0, 1", inside=number("fov", 38))
    return view + "".join(walls + boxes) + lamp("12, 10, 7", light)


def _textures():
    """Every filter and wrap mode of a bitmap, stored in sRGB or linear."""
    tiles, i = [], 0
    for wrap in ("repeat", "mirror", "clamp"):
        for kind in ("bilinear", "nearest"):
            steps = '<rotate z="1" angle="20"/><scale value="2.2"/><translate x="-0.4" y="-0.3"/>'
            settings = text("wrap_mode", wrap) + text("filter_type", kind) + to_world(steps, "to_uv")
            picture = bsdf("diffuse", bitmap("reflectance", "colours.png", settings, raw=i == 3))
            x, z = 1.5 * (i // 2 - 1), 0.8 + 1.5 * (i % 2)
            place = to_world(f'<scale value="0.7"/><rotate x="1" angle="90"/><translate x="{x}" z="{z}"/>')
            tiles.append(shape("rectangle", f"tile{i}", place, picture))
            i += 1
    return "".join(tiles)


def _instances():
    """A group of three shapes, twice, one of them mirrored."""
    group = shape(
        "shapegroup",
        "group",
        shape("cube", "a", at(0, 0, 0.3, 0.3), diffuse("0.7, 0.3, 0.2")),
        mesh("stone.obj", "b", at(0.2, 0.1, 0.9, 0.35), diffuse("0.3, 0.5, 0.7")),
        mesh("ball.ply", "c", at(-0.1, -0.4, 0.8, 0.2), bsdf("plastic", rgb("diffuse_reflectance", "0.2, 0.6, 0.3"))),
    )
    one = shape("instance", "one", '<ref id="group"/>', to_world('<translate x="-1"/>'))
    steps = f'<scale x="-1.2" y="1" z="1.3"/>{TURN}<translate x="1" y="0.4"/>'
    return group + one + shape("instance", "two", '<ref id="group"/>', to_world(steps))


def _glossy(distribution):
    gold = [text("material", "Au"), text("distribution", distribution)]
    rough = bsdf("roughconductor", rgb("eta", "1.6, 0.9, 0.5"), rgb("k", "9, 6, 5"), number("alpha", 0.5), gold[1])
    return row(
        bsdf("roughconductor", number("alpha", 0.08), *gold),
        bsdf("roughconductor", number("alpha", 0.25), *gold),
        rough,
    )


def _stand(kind, *inside):
    """An upright square."""
    return shape(
        "rectangle", kind, to_world('<scale value="0.8"/><rotate x="1" angle="75"/><translate z="0.9"/>'), *inside
    )


GLASS = row(
    bsdf("dielectric"), bsdf("dielectric", number("int_ior", 1.3), rgb("specular_transmittance", "0.8, 0.9, 1"))
)
PRINCIPLED = row(
    *(
        bsdf(
            "principled",
            rgb("base_color", "0.8, 0.4, 0.2"),
            number("metallic", m),
            number("roughness", r),
            number("specular", s),
        )
        for m, r, s in ((0.0, 0.3, 0.5), (1.0, 0.25, 0.5), (0.5, 0.6, 0.9))
    )
)
CURVED = (
    shape(
        "sphere",
        "ball",
        '<point name="center" value="-1.2, 0, 0.8"/>',
        number("radius", 0.8),
        bsdf("diffuse", board("reflectance", steps='<scale x="8" y="4"/>')),
    )
    + shape(
        "cylinder",
        "tube",
        '<point name="p0" value="0.6, 0.5, 0"/><point name="p1" value="0.8, 0.3, 1.6"/>',
        number("radius", 0.4),
        bsdf("twosided", bsdf("diffuse", bitmap("reflectance"))),
    )
    + shape(
        "disk", "plate", to_world('<scale value="0.6"/><rotate x="1" angle="60"/><translate x="1.8" y="-0.4" z="0.8"/>')
    )
)
VIEW, STAGE = sensor(), FLOOR + lamp() + SKY

CASES = {
    "cornell": Case(_room(), max_depth=5, spp=256),
    "white_room": Case(_room().replace("0.7, 0.7, 0.7", "0.9, 0.9, 0.9"), max_depth=9, spp=256),
    "meshes": Case(
        VIEW
        + STAGE
        + mesh("bumpy.obj", "smooth", at(-1.5, 0, 0.9, 0.8), diffuse("0.7, 0.3, 0.2"))
        + mesh("bumpy.obj", "flat", yes("face_normals"), at(0, 0.6, 0.9, 0.8), diffuse("0.3, 0.7, 0.2"))
        + mesh("stone.obj", "computed", at(1.5, 0, 0.9, 0.7), diffuse("0.2, 0.3, 0.7"))
    ),
    "coarse_normals": Case(
        VIEW + STAGE + mesh("coarse.obj", "coarse", at(0, 0, 0.9, 0.8), diffuse("0.6, 0.6, 0.6")),
        note="interpolated normals that face away from the viewer: black in Mitsuba, turned here",
        differs=True,
    ),
    "curved": Case(VIEW + STAGE + CURVED, note="Mitsuba is given the same tessellation"),
    "instances": Case(VIEW + STAGE + _instances()),
    "mirrors": Case(
        VIEW
        + STAGE
        + _stand("conductor", bsdf("twosided", bsdf("conductor", rgb("specular_reflectance", "0.9, 0.95, 1"))))
        + shape("cube", "copper", at(1.5, -0.8, 0.5, 0.5, TURN), bsdf("conductor", text("material", "Cu")))
        + shape("cube", "clay", at(-1.4, -0.9, 0.4, 0.4, TURN), diffuse("0.7, 0.2, 0.1")),
        max_depth=4,
    ),
    "rough_metal": Case(VIEW + STAGE + _glossy("ggx"), spp=256),
    "rough_metal_beckmann": Case(
        VIEW + STAGE + _glossy("beckmann"), spp=256, note="Mitsuba's masking is a fit, up to 0.4 % off"
    ),
    "glass": Case(VIEW + FLOOR + ENVIRONMENT + GLASS, max_depth=7, spp=512),
    "glass_cube": Case(
        VIEW + STAGE + shape("cube", "block", at(0, -0.3, 0.9, 0.8, TURN), bsdf("dielectric")), max_depth=6, spp=512
    ),
    "panes": Case(
        VIEW
        + STAGE
        + _stand("pane", bsdf("thindielectric"), '<boolean name="flip_normals" value="true"/>')
        + mesh("ball.ply", "behind", at(0.2, 1.4, 0.7, 0.7), diffuse("0.7, 0.2, 0.1")),
        max_depth=4,
        spp=256,
    ),
    "rough_glass": Case(
        VIEW + FLOOR + ENVIRONMENT + row(*(bsdf("roughdielectric", GGX, number("alpha", a)) for a in (0.15, 0.4))),
        max_depth=5,
        spp=512,
    ),
    "plastic": Case(
        VIEW
        + STAGE
        + row(
            bsdf("plastic", rgb("diffuse_reflectance", "0.6, 0.2, 0.1")),
            bsdf("plastic", rgb("diffuse_reflectance", "0.1, 0.5, 0.2"), yes("nonlinear"), number("int_ior", 1.9)),
        ),
        spp=256,
    ),
    "rough_plastic": Case(
        VIEW
        + STAGE
        + row(
            bsdf("roughplastic", GGX, rgb("diffuse_reflectance", "0.6, 0.2, 0.1"), number("alpha", 0.2)),
            bsdf(
                "roughplastic", GGX, rgb("diffuse_reflectance", "0.1, 0.2, 0.6"), number("alpha", 0.4), yes("nonlinear")
            ),
        ),
        spp=256,
        note="Mitsuba's quadrature of the internal reflectance is up to 2 % off",
    ),
    "principled": Case(VIEW + STAGE + PRINCIPLED, spp=256),
    "mask": Case(
        VIEW
        + STAGE
        + _stand(
            "holes",
            bsdf(
                "mask",
                bitmap("opacity", "holes.png", text("filter_type", "nearest"), raw=True),
                bsdf("twosided", diffuse("0.8, 0.3, 0.1")),
            ),
        )
        + mesh(
            "ball.ply",
            "veil",
            at(1.6, -0.8, 0.6, 0.6),
            bsdf("mask", number("opacity", 0.6), bsdf("twosided", diffuse("0.1, 0.3, 0.8"))),
        ),
        max_depth=4,
    ),
    "normal_map": Case(
        VIEW
        + lamp()
        + SKY
        + shape(
            "rectangle",
            "floor",
            to_world('<scale value="4"/>'),
            bsdf("normalmap", bitmap("normalmap", "normal.png", raw=True), diffuse("0.6, 0.5, 0.4")),
        )
        + shape(
            "cube",
            "block",
            at(0, 0, 0.8, 0.8, TURN),
            bsdf(
                "twosided",
                bsdf(
                    "normalmap",
                    bitmap("normalmap", "normal.png", raw=True),
                    bsdf("roughconductor", GGX, number("alpha", 0.3)),
                ),
            ),
        ),
        spp=256,
    ),
    "textures": Case(sensor(origin="0, -6, 1.6", target="0, 0, 1.5") + SKY + _textures() + FLOOR),
    "textured_lobes": Case(
        VIEW
        + SKY
        + lamp()
        + shape(
            "rectangle",
            "floor",
            to_world('<scale value="4"/>'),
            bsdf(
                "principled",
                bitmap("base_color"),
                bitmap("roughness", "grey.png", raw=True),
                bitmap("metallic", "grey.png", raw=True),
            ),
        )
        + mesh(
            "coloured.ply",
            "vertices",
            at(-1.2, 0, 0.8, 0.8),
            bsdf(
                "diffuse",
                f'<texture type="mesh_attribute" name="reflectance">{text("name", "vertex_color")}</texture>',
            ),
        )
        + shape(
            "cube",
            "brushed",
            at(1.2, 0, 0.7, 0.7, TURN),
            bsdf("roughconductor", GGX, bitmap("alpha", "grey.png", raw=True)),
        ),
        spp=256,
    ),
    "environment": Case(
        VIEW
        + BOARD
        + emitter(
            "envmap",
            text("filename", "sky.pfm"),
            number("scale", 1.3),
            to_world('<rotate x="1" angle="90"/><rotate z="1" angle="130"/>'),
        )
        + row(
            bsdf("roughconductor", GGX, text("material", "Al"), number("alpha", 0.15)),
            diffuse("0.7, 0.7, 0.7"),
            bsdf("conductor"),
        ),
        spp=256,
    ),
    "studio": Case(
        VIEW
        + BOARD
        + ENVIRONMENT
        + shape(
            "cube",
            "gold",
            at(-1.5, 0, 0.6, 0.5, TURN),
            bsdf("roughconductor", GGX, text("material", "Au"), number("alpha", 0.2)),
        )
        + shape(
            "cube", "lacquer", at(0, 0.4, 0.6, 0.5, TURN), bsdf("plastic", rgb("diffuse_reflectance", "0.5, 0.1, 0.1"))
        )
        + shape(
            "cube",
            "mixed",
            at(1.5, 0, 0.6, 0.5, TURN),
            bsdf("principled", rgb("base_color", "0.2, 0.5, 0.7"), number("metallic", 0.4)),
        ),
        max_depth=4,
        spp=256,
    ),
    "spectra": Case(
        VIEW
        + SKY.replace('<rgb name="radiance" value="0.4, 0.5, 0.6"/>', spectrum("radiance", "0.4"))
        + shape(
            "rectangle",
            "lamp",
            to_world('<rotate x="1" angle="180"/><translate x="0.5" y="-1" z="4"/>'),
            emitter("area", spectrum("radiance", "400:0, 500:8, 600:15.6, 700:18.4")),
        )
        + shape(
            "rectangle",
            "floor",
            to_world('<scale value="4"/>'),
            bsdf(
                "diffuse",
                spectrum("reflectance", "400:0.34, 420:0.63, 460:0.71, 540:0.74, 620:0.76, 700:0.74"),
            ),
        )
        + shape(
            "cube",
            "green",
            at(-1, 0, 0.6, 0.5, TURN),
            bsdf(
                "diffuse",
                spectrum("reflectance", "400:0.09, 500:0.25, 532:0.48, 560:0.37, 600:0.17, 700:0.2"),
            ),
        )
        + shape(
            "cube",
            "metal",
            at(1, 0, 0.6, 0.5, TURN),
            bsdf(
                "roughconductor",
                GGX,
                number("alpha", 0.2),
                spectrum("eta", "400:1.6, 500:1.2, 600:0.9, 700:0.4"),
                spectrum("k", "400:4, 500:5, 600:6, 700:7"),
            ),
        ),
    ),
    "sun": Case(
        VIEW
        + BOARD
        + SKY
        + emitter("directional", '<vector name="direction" value="0.4, 0.5, -1"/>', rgb("irradiance", "2, 1.8, 1.5"))
        + mesh("stone.obj", "stone", at(0, 0, 0.9, 0.8), diffuse("0.6, 0.6, 0.6"))
    ),
    "spots": Case(
        VIEW
        + FLOOR
        + emitter("point", '<point name="position" value="-1.5, -1, 2.5"/>', rgb("intensity", "4, 3, 2"))
        + emitter(
            "spot",
            to_world('<lookat origin="2, -2, 3" target="0.3, 0, 0.4" up="0, 0, 1"/>'),
            rgb("intensity", "20, 25, 30"),
            number("cutoff_angle", 22),
            number("beam_width", 12),
        )
        + row(diffuse("0.6, 0.6, 0.6"), bsdf("roughconductor", GGX, number("alpha", 0.3)))
    ),
    "projector": Case(
        VIEW
        + FLOOR
        + SKY
        + emitter(
            "projector",
            to_world('<lookat origin="1, -4, 3" target="0, 0, 0.4" up="0, 0, 1"/>'),
            number("fov", 35),
            number("scale", 20),
            bitmap("irradiance"),
        )
        + mesh("bumpy.obj", "bumpy", at(0, 0, 0.9, 0.8), diffuse("0.8, 0.8, 0.8"))
    ),
    "many_lights": Case(
        VIEW
        + FLOOR
        + SKY
        + lamp("2, 8, 3", name="green")
        + lamp("20, 4, 3", '<scale value="0.3"/><rotate x="1" angle="150"/><translate x="-2" y="1" z="2"/>', "red")
        + shape("cube", "glowing", at(1.5, 0.8, 0.3, 0.3, TURN), diffuse(), area("1, 2, 4"))
        + emitter("point", '<point name="position" value="0, -2, 3"/>', rgb("intensity", "3, 3, 3"))
        + emitter("directional", '<vector name="direction" value="-1, 0.5, -1"/>', rgb("irradiance", "0.3, 0.3, 0.5"))
        + row(diffuse("0.8, 0.8, 0.8"), bsdf("plastic"))
    ),
    "lens": Case(
        sensor("thinlens", inside=number("fov", 42) + number("aperture_radius", 0.3) + number("focus_distance", 5.5))
        + BOARD
        + SKY
        + lamp()
        + row(diffuse("0.7, 0.2, 0.1"), diffuse("0.1, 0.2, 0.7"))
    ),
    "parallel": Case(
        sensor(
            "orthographic", inside=number("near_clip", 5.2) + number("far_clip", 8), first='<scale x="2.4" y="2.4"/>'
        )
        + STAGE
        + row(diffuse("0.7, 0.2, 0.1"), diffuse("0.1, 0.2, 0.7"))
    ),
    "crop": Case(
        sensor(
            inside=number("fov", 42)
            + number("principal_point_offset_x", 0.1)
            + number("principal_point_offset_y", -0.07)
            + number("near_clip", 5.4)
            + number("far_clip", 9),
            film=film(
                '<rfilter type="tent"/>',
                (40, 30),
                "".join(
                    f'<integer name="crop_{n}" value="{v}"/>'
                    for n, v in (("offset_x", 8), ("offset_y", 6), ("width", 24), ("height", 18))
                ),
            ),
        )
        + STAGE
        + row(diffuse("0.7, 0.2, 0.1"), diffuse("0.1, 0.2, 0.7")),
        spp=512,
        note="Mitsuba divides by the weights of a pixel's own samples",
    ),
    "gaussian": Case(
        sensor(
            inside=text("focal_length", "50mm"),
            film=film('<rfilter type="gaussian"><float name="stddev" value="0.6"/></rfilter>'),
        )
        + STAGE
        + mesh("stone.obj", "stone", at(0, 0, 0.9, 0.8), diffuse("0.6, 0.6, 0.6")),
        spp=512,
        note="Mitsuba divides by the weights of a pixel's own samples",
    ),
}

STORED = ("cornell", "glass_cube", "studio")  # without large files
