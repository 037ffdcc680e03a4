"""Mitsuba XML from Python: a function for each kind of element."""

SIZE = (24, 18)
BOX = '<rfilter type="box"/>'


def number(name, value):
    return f'<float name="{name}" value="{value}"/>'


def text(name, value):
    return f'<string name="{name}" value="{value}"/>'


def yes(name, value="true"):
    return f'<boolean name="{name}" value="{value}"/>'


def rgb(name, value):
    return f'<rgb name="{name}" value="{value}"/>'


def spectrum(name, value):
    return f'<spectrum name="{name}" value="{value}"/>'


def film(rfilter=BOX, size=SIZE, inside=""):
    width, height = size
    size = f'<integer name="width" value="{width}"/><integer name="height" value="{height}"/>'
    border = yes("sample_border") + text("pixel_format", "rgb")
    return f'<film type="hdrfilm">{size}{border}{inside}{rfilter}</film>'


FOV, FILM = number("fov", 42), film()


def sensor(kind="perspective", origin="0, -6, 3", target="0, 0, 0.6", inside=FOV, film=FILM, first=""):
    place = to_world(f'{first}<lookat origin="{origin}" target="{target}" up="0, 0, 1"/>')
    return f'<sensor type="{kind}">{inside}{place}{film}</sensor>\n'


def to_world(steps, name="to_world"):
    return f'<transform name="{name}">{steps}</transform>'


def at(x, y, z, scale=1.0, turn=""):
    return to_world(f'<scale value="{scale}"/>{turn}<translate x="{x}" y="{y}" z="{z}"/>')


def shape(kind, name, *inside):
    return f'<shape type="{kind}" id="{name}">{"".join(inside)}</shape>\n'


def mesh(file, name, *inside):
    return shape(file.rsplit(".", 1)[1], name, text("filename", file), *inside)


def bsdf(kind, *inside):
    return f'<bsdf type="{kind}">{"".join(inside)}</bsdf>'


def diffuse(color="0.5"):
    return bsdf("diffuse", rgb("reflectance", color))


def bitmap(field, file="colours.png", *inside, raw=False):
    settings = text("filename", file) + text("format", "variant") + (yes("raw") if raw else "")
    return f'<texture type="bitmap" name="{field}">{settings}{"".join(inside)}</texture>'


def board(field, first="0.8, 0.7, 0.2", second="0.1, 0.2, 0.4", steps='<scale x="5" y="4"/>'):
    colors = rgb("color0", first) + rgb("color1", second)
    return f'<texture type="checkerboard" name="{field}">{colors}{to_world(steps, "to_uv")}</texture>'


def area(radiance):
    return f'<emitter type="area">{rgb("radiance", radiance)}</emitter>'


def emitter(kind, *inside):
    return f'<emitter type="{kind}">{"".join(inside)}</emitter>\n'


def lamp(radiance="9, 8, 7", steps='<rotate x="1" angle="180"/><translate x="0.5" y="-1" z="4"/>', name="lamp"):
    return shape("rectangle", name, to_world(steps), area(radiance))


def row(*bsdfs, kind="ball.ply"):
    """The same body of several materials, side by side."""
    step = 4.4 / len(bsdfs)
    place = [at(step * (i - (len(bsdfs) - 1) / 2), 0.0, 0.9, 0.45 * step) for i in range(len(bsdfs))]
    return "".join(mesh(kind, f"body{i}", to, b) for i, (to, b) in enumerate(zip(place, bsdfs, strict=True)))
