"""The four scenes of the study: a diffuse room, glossy bodies, a textured mesh under a sky, and glass."""

from experiments.forward_images.markup import (
    area,
    at,
    bitmap,
    board,
    bsdf,
    diffuse,
    emitter,
    film,
    mesh,
    number,
    rgb,
    sensor,
    shape,
    text,
    to_world,
)
from experiments.forward_images.scenes import CASES, Case

GGX = text("distribution", "ggx")
FLOOR = shape("rectangle", "floor", to_world('<scale value="4"/>'), bsdf("diffuse", board("reflectance")))
LAMP = shape(
    "rectangle", "lamp", to_world('<rotate x="1" angle="180"/><translate x="0.5" y="-1" z="4"/>'), area("9, 8, 7")
)
SKY = emitter("constant", rgb("radiance", "0.4, 0.5, 0.6"))
PHOTO = emitter("envmap", text("filename", "sky.pfm"), to_world('<rotate x="1" angle="90"/>'))


def _bodies(*bsdfs):
    return "".join(mesh("ball.ply", f"body{i}", at(1.6 * (i - 1), 0, 0.9, 0.75), b) for i, b in enumerate(bsdfs))


def _sphere(name, x, *inside):
    """A sphere plugin: it has UVs."""
    place = f'<point name="center" value="{x}, 0, 0.9"/>' + number("radius", 0.9)
    return shape("sphere", name, place, *inside)


def scenes(size):
    """Name -> scene of `size` x `size` pixels."""
    view = sensor(film=film(size=(size, size)))
    glossy = _bodies(
        bsdf("roughconductor", GGX, text("material", "Au"), number("alpha", 0.15)),
        bsdf("plastic", rgb("diffuse_reflectance", "0.6, 0.2, 0.1")),
        bsdf("roughplastic", GGX, rgb("diffuse_reflectance", "0.1, 0.2, 0.6"), number("alpha", 0.2)),
    )
    textured = mesh("bumpy.obj", "bumpy", at(-1.2, 0, 0.9, 0.8), diffuse("0.7, 0.6, 0.5"))
    textured += _sphere("globe", 1.1, bsdf("principled", bitmap("base_color"), number("roughness", 0.4)))
    glass = _bodies(bsdf("dielectric"), bsdf("dielectric", number("int_ior", 1.3)), diffuse("0.7, 0.2, 0.1"))
    room = CASES["cornell"].content
    small = film()
    assert small in room
    contents = {
        "diffuse room": room.replace(small, film(size=(size, size))),
        "glossy": view + FLOOR + LAMP + SKY + glossy,
        "sky and textures": view + FLOOR + PHOTO + textured,
        "glass": view + FLOOR + PHOTO + glass,
    }
    return {name: Case(content, max_depth=6) for name, content in contents.items()}
