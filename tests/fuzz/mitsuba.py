"""Scene files of Mitsuba, as `jaxdr.load_mitsuba` reads them, with all kinds of elements."""

from pathlib import Path

import numpy as np
from PIL import Image

from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.formats.mitsuba.settings import mitsuba_settings
from tests.fuzz.kind import Kind

SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- a comment -- with dashes -->
<scene version="3.0.0">
    <default name="spp" value="4"/>
    <default name="size" value="12"/>
    <path value="parts"/>
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective" id="eye">
        <float name="fov" value="40"/>
        <float name="near_clip" value="0.1"/>
        <transform name="to_world">
            <scale value="1"/>
            <lookat origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$size"/>
            <integer name="height" value="9"/>
            <integer name="crop_width" value="8"/>
            <string name="pixel_format" value="rgb"/>
            <rfilter type="gaussian"><float name="stddev" value="0.5"/></rfilter>
        </film>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
    </sensor>
    <texture type="checkerboard" id="board">
        <rgb name="color0" value="0.1, 0.2, 0.3"/>
        <transform name="to_uv"><scale x="4" y="4"/></transform>
    </texture>
    <texture type="bitmap" id="wood">
        <string name="filename" value="a.png"/>
        <string name="wrap_mode" value="mirror"/>
        <boolean name="raw" value="true"/>
    </texture>
    <bsdf type="twosided" id="painted"><bsdf type="diffuse"><ref id="board" name="reflectance"/></bsdf></bsdf>
    <bsdf type="blendbsdf" id="blend">
        <float name="weight" value="0.3"/>
        <bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value="0.2"/></bsdf>
        <bsdf type="mask"><float name="opacity" value="0.7"/><bsdf type="plastic"/></bsdf>
    </bsdf>
    <alias id="blend" as="metal"/>
    <include filename="part.xml"/>
    <shape type="obj" id="mesh">
        <string name="filename" value="a.obj"/>
        <boolean name="face_normals" value="false"/>
        <ref id="metal"/>
    </shape>
    <shape type="sphere" id="ball">
        <point name="center" x="1" y="0" z="0.5"/>
        <float name="radius" value="0.5"/>
        <bsdf type="principled"><float name="roughness" value="0.4"/><float name="eta" value="1.5"/></bsdf>
    </shape>
    <emitter type="point">
        <point name="position" value="0, 3, 0"/>
        <spectrum name="intensity" value="400:1, 500:2, 700:1.5"/>
    </emitter>
    <emitter type="envmap"><string name="filename" value="a.png"/><float name="scale" value="0.5"/></emitter>
</scene>
"""
PART = """<scene version="3.0.0">
    <shape type="rectangle" id="wall">
        <transform name="to_world">
            <rotate y="1" angle="30"/><scale x="2" y="1" z="1"/><translate x="1" z="-1"/>
            <matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/>
        </transform>
        <bsdf type="diffuse"><spectrum name="reflectance" filename="a.spd"/></bsdf>
    </shape>
    <shape type="cylinder">
        <point name="p1" value="0, 0, 2"/>
        <bsdf type="bumpmap"><ref id="wood"/><float name="scale" value="0.1"/><bsdf type="thindielectric"/></bsdf>
    </shape>
    <shape type="shapegroup" id="group"><shape type="cube"><bsdf type="dielectric"/></shape></shape>
    <shape type="instance">
        <ref id="group"/>
        <transform name="to_world"><translate x="3"/></transform>
    </shape>
    <shape type="disk"><ref id="painted"/><emitter type="area"><rgb name="radiance" value="3"/></emitter></shape>
    <emitter type="spot"><float name="cutoff_angle" value="25"/><rgb name="intensity" value="1, 2, 3"/></emitter>
    <emitter type="directional"><vector name="direction" x="0" y="-1" z="0"/></emitter>
</scene>
"""
OLD = """<?xml version="1.0" encoding="utf-8"?>
<scene version="0.6.0">
    <sensor type="perspective">
        <string name="focalLength" value="50mm"/>
        <float name="nearClip" value="0.1"/>
        <transform name="toWorld"><lookAt origin="0 0 5" target="0 0 0"/></transform>
        <film type="ldrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
    </sensor>
    <shape type="rectangle">
        <bsdf type="mixturebsdf">
            <string name="weights" value="0.2, 0.5"/>
            <bsdf type="diffuse">
                <texture type="scale" name="diffuseReflectance">
                    <float name="scale" value="0.5"/>
                    <texture type="bitmap">
                        <string name="filename" value="parts/a.png"/>
                        <string name="filterType" value="trilinear"/>
                        <float name="gamma" value="2.2"/>
                        <float name="uscale" value="2"/>
                    </texture>
                </texture>
            </bsdf>
            <bsdf type="roughconductor">
                <spectrum name="eta" value="0.2, 0.9, 1.1"/>
                <spectrum name="k" value="3.9, 2.4, 2.2"/>
                <float name="extEta" value="1.33"/>
            </bsdf>
        </bsdf>
    </shape>
    <shape type="cube">
        <bsdf type="phong"><srgb name="diffuseReflectance" value="#102030"/><float name="exponent" value="20"/></bsdf>
    </shape>
    <emitter type="constant"><spectrum name="radiance" value="2"/></emitter>
</scene>
"""
OBJECT = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
SPECTRUM = "# nm, reflectance\n400 0.1\n500 0.5\n600 0.7\n700 0.2\n"


def kinds() -> list[Kind]:
    """A scene of Mitsuba 3 in two files with a spectrum, and one of Mitsuba 0.x."""
    return [
        Kind("mitsuba", lambda folder: _write(folder, SCENE), _read, ("*.xml", "*.spd"), text=True),
        Kind("mitsuba_bytes", lambda folder: _write(folder, SCENE), _read, ("*.xml",)),
        Kind("mitsuba_0", lambda folder: _write(folder, OLD), _read, ("*.xml",), text=True),
    ]


def _write(folder: Path, scene: str) -> None:
    parts = folder / "parts"
    parts.mkdir()
    (folder / "scene.xml").write_text(scene)
    (parts / "a.obj").write_text(OBJECT)
    Image.fromarray(np.arange(60, dtype=np.uint8).reshape(4, 5, 3)).save(parts / "a.png")
    if scene is SCENE:
        (parts / "part.xml").write_text(PART)
        (parts / "a.spd").write_text(SPECTRUM)


def _read(folder: Path) -> object:
    mitsuba_settings(folder / "scene.xml")
    return load_mitsuba(folder / "scene.xml", ignore_unsupported=True)
