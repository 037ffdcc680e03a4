"""Scene files as they are found in galleries: their idioms, with procedural meshes and made-up numbers."""
# ruff: noqa: E501

import numpy as np

from jaxdr.geometry.shapes import displaced_sphere, sphere
from jaxdr.images import write_image

# As of Mitsuba's own tutorials.
CORNELL = """<scene version="3.0.0">
    <default name="spp" value="128"/>
    <default name="res" value="256"/>
    <default name="max_depth" value="6"/>
    <default name="integrator" value="path"/>

    <integrator type='$integrator'>
        <integer name="max_depth" value="$max_depth"/>
    </integrator>

    <sensor type="perspective" id="sensor">
        <string name="fov_axis" value="smaller"/>
        <float name="near_clip" value="0.001"/>
        <float name="far_clip" value="100.0"/>
        <float name="focus_distance" value="1000"/>
        <float name="fov" value="39.3077"/>
        <transform name="to_world">
            <lookat origin="0,  0,  4"
                    target="0,  0,  0"
                    up    ="0,  1,  0"/>
        </transform>
        <sampler type="independent">
            <integer name="sample_count" value="$spp"/>
        </sampler>
        <film type="hdrfilm">
            <integer name="width"  value="$res"/>
            <integer name="height" value="$res"/>
            <rfilter type="tent"/>
            <string name="pixel_format" value="rgb"/>
            <string name="component_format" value="float32"/>
        </film>
    </sensor>

    <!-- BSDFs -->
    <bsdf type="diffuse" id="gray">
        <rgb name="reflectance" value="0.8, 0.8, 0.8"/>
    </bsdf>
    <bsdf type="diffuse" id="white">
        <spectrum name="reflectance" value="400:0.34, 420:0.63, 460:0.71, 540:0.74, 620:0.76, 700:0.74"/>
    </bsdf>
    <bsdf type="diffuse" id="green">
        <spectrum name="reflectance"
            value="400:0.09, 460:0.13, 500:0.25, 532:0.48, 560:0.37, 600:0.17, 640:0.14, 700:0.2"/>
    </bsdf>
    <bsdf type="diffuse" id="red">
        <spectrum name="reflectance" value="400:0.04, 540:0.06, 580:0.12, 600:0.4, 620:0.57, 700:0.65"/>
    </bsdf>
    <bsdf type="dielectric" id="glass"/>
    <bsdf type="conductor" id="mirror"/>

    <!-- Light -->
    <shape type="obj" id="light">
        <string name="filename" value="meshes/luminaire.obj"/>
        <transform name="to_world">
            <translate x="0" y="-0.01" z="0"/>
        </transform>
        <ref id="white"/>
        <emitter type="area">
            <spectrum name="radiance" value="400:0, 500:8, 600:15.6, 700:18.4"/>
        </emitter>
    </shape>

    <!-- Shapes -->
    <shape type="obj" id="floor">
        <string name="filename" value="meshes/floor.obj"/>
        <ref id="white"/>
    </shape>
    <shape type="obj" id="ceiling">
        <string name="filename" value="meshes/ceiling.obj"/>
        <ref id="white"/>
    </shape>
    <shape type="obj" id="back">
        <string name="filename" value="meshes/back.obj"/>
        <ref id="white"/>
    </shape>
    <shape type="obj" id="greenwall">
        <string name="filename" value="meshes/right.obj"/>
        <ref id="green"/>
    </shape>
    <shape type="obj" id="redwall">
        <string name="filename" value="meshes/left.obj"/>
        <ref id="red"/>
    </shape>
    <shape type="sphere" id="mirrorsphere">
        <transform name="to_world">
            <scale value="0.5"/>
            <translate x="-0.3" y="-0.5" z="0.2"/>
        </transform>
        <ref id="mirror"/>
    </shape>
    <shape type="sphere" id="glasssphere">
        <transform name="to_world">
            <scale value="0.25"/>
            <translate x="0.5" y="-0.75" z="-0.2"/>
        </transform>
        <ref id="glass"/>
    </shape>
</scene>
"""

# As an exporter of a well-known collection writes them: matrices, two-sided BSDFs, no ids at shapes.
VEACH = """<?xml version="1.0" encoding="utf-8"?>
<scene version="3.0.0" >
	<default name="integrator" value="path" />
	<default name="spp" value="64" />
	<default name="resx" value="64" />
	<default name="resy" value="36" />
	<default name="max_depth" value="65" />
	<integrator type='$integrator' >
		<integer name="max_depth" value="$max_depth" />
	</integrator>
	<sensor type="perspective" >
		<float name="fov" value="35" />
		<transform name="to_world" >
			<matrix value="1e-08 -0.0318094 -0.999494 28.2792 1e-08 0.999494 -0.0318094 3.5 1 1e-08 1e-08 1e-08 0 0 0 1" />
		</transform>
		<sampler type="independent" >
			<integer name="sample_count" value="$spp" />
		</sampler>
		<film type="hdrfilm" >
			<integer name="width" value="$resx" />
			<integer name="height" value="$resy" />
			<string name="file_format" value="openexr" />
			<string name="pixel_format" value="rgb" />
			<rfilter type="tent" />
		</film>
	</sensor>
	<bsdf type="twosided" id="DiffuseBSDF" >
		<bsdf type="diffuse" >
			<rgb name="reflectance" value="0.5, 0.5, 0.5" />
		</bsdf>
	</bsdf>
	<bsdf type="twosided" id="RoughBSDF" >
		<bsdf type="roughconductor" >
			<string name="distribution" value="ggx" />
			<float name="alpha" value="0.1" />
			<rgb name="specular_reflectance" value="1, 1, 1" />
			<rgb name="eta" value="4.36968, 2.9167, 1.6547" />
			<rgb name="k" value="5.20643, 4.23136, 3.75495" />
		</bsdf>
	</bsdf>
	<bsdf type="twosided" id="SmoothBSDF" >
		<bsdf type="roughconductor" >
			<string name="distribution" value="ggx" />
			<float name="alpha" value="0.02" />
			<string name="material" value="Cr" />
		</bsdf>
	</bsdf>
	<bsdf type="twosided" id="NullBSDF" >
		<bsdf type="diffuse" >
			<rgb name="reflectance" value="0, 0, 0" />
		</bsdf>
	</bsdf>
	<shape type="rectangle" >
		<transform name="to_world" >
			<matrix value="-4.4e-008 9.9 4.3e-008 0.5 0 -4.3e-007 1 -1 23.7602 1.03e-006 1.9e-015 0 0 0 0 1" />
		</transform>
		<ref id="DiffuseBSDF" />
	</shape>
	<shape type="cube" >
		<transform name="to_world" >
			<matrix value="0.9 -0.43 0 3 0.43 0.09 0 0.3 0 0 4 0 0 0 0 1"/>
		</transform>
		<ref id="RoughBSDF" />
	</shape>
	<shape type="obj" >
		<string name="filename" value="meshes/plate.obj" />
		<boolean name="face_normals" value="true" />
		<transform name="to_world" >
			<matrix value="4 0 0 0.5 0 1 0 -0.5 0 0 4 0 0 0 0 1"/>
		</transform>
		<ref id="SmoothBSDF" />
	</shape>
	<shape type="sphere" >
		<float name="radius" value="0.5" />
		<point name="center" x="0" y="6.5" z="2.7" />
		<ref id="NullBSDF" />
		<emitter type="area" >
			<rgb name="radiance" value="175.99, 175.99, 175.99" />
		</emitter>
	</shape>
	<shape type="sphere" >
		<float name="radius" value="0.1" />
		<point name="center" x="0" y="6.5" z="-2.7" />
		<ref id="NullBSDF" />
		<emitter type="area" >
			<rgb name="radiance" value="901.803, 901.803, 901.803" />
		</emitter>
	</shape>
</scene>
"""

# As of a material preview: an environment map, a checkerboard under an object, its material in a file of its own.
PREVIEW = """<?xml version='1.0' encoding='utf-8'?>
<scene version="2.1.0">
    <default name="material" value="materials/lacquer.xml"/>
    <path value="assets"/>
    <integrator type="path"/>
    <sensor type="perspective" id="Camera-camera">
        <string name="fov_axis" value="smaller"/>
        <float name="focus_distance" value="6.0"/>
        <float name="fov" value="28.8415"/>
        <transform name="to_world">
            <scale x="-1"/>
            <lookat target="3.04072, -2.85176, 2.80939" origin="3.69558, -3.46243, 3.25463"
                    up="-0.317366, 0.312466, 0.895346"/>
        </transform>
        <sampler type="multijitter"><integer name="sample_count" value="16"/></sampler>
        <film type="hdrfilm" id="film">
            <integer name="width" value="40"/>
            <integer name="height" value="30"/>
            <string name="pixel_format" value="rgba"/>
            <boolean name="banner" value="false"/>
            <rfilter type="gaussian"/>
        </film>
    </sensor>
    <emitter type="envmap" id="Area_002-light">
        <string name="filename" value="envmap.pfm"/>
        <transform name="to_world">
            <rotate y="1" angle="-180"/>
            <matrix value="-0.224951 -0.000001 -0.974370 0 -0.974370 0 0.224951 0 0 1 -0.000001 8.870000 0 0 0 1"/>
        </transform>
        <float name="scale" value="3"/>
    </emitter>
    <texture type="checkerboard" id="__planetex">
        <rgb name="color0" value="0.4"/>
        <rgb name="color1" value="0.2"/>
        <transform name="to_uv"><scale x="8" y="8"/></transform>
    </texture>
    <bsdf type="diffuse" id="__planemat">
        <ref name="reflectance" id="__planetex"/>
    </bsdf>
    <bsdf type="twosided" id="stand"><bsdf type="diffuse"><rgb name="reflectance" value="0.2"/></bsdf></bsdf>
    <include filename="$material"/>
    <alias id="lacquer" as="preview-material"/>
    <shape type="rectangle" id="Plane-mesh_0">
        <transform name="to_world"><scale value="4"/><rotate z="1" angle="-44.5"/></transform>
        <ref id="__planemat"/>
    </shape>
    <shape type="ply" id="Inside-mesh_0">
        <string name="filename" value="stand.ply"/>
        <transform name="to_world">
            <matrix value="0.4 0 0 0
                           0 0.4 0 0
                           0 0 0.4 0.4
                           0 0 0 1"/>
        </transform>
        <ref id="stand"/>
    </shape>
    <shape type="obj" id="Exterior-mesh_0">
        <string name="filename" value="body.obj"/>
        <transform name="to_world"><scale value="0.7"/><translate z="1.1"/></transform>
        <ref name="bsdf" id="preview-material"/>
    </shape>
</scene>
"""

LACQUER = """<scene version="2.1.0">
    <bsdf type="roughplastic" id="lacquer">
        <string name="distribution" value="ggx"/>
        <string name="int_ior" value="acrylic glass"/>
        <float name="alpha" value="0.1"/>
        <boolean name="nonlinear" value="true"/>
        <texture type="bitmap" name="diffuse_reflectance">
            <string name="filename" value="wood.png"/>
            <string name="filter_type" value="bilinear"/>
            <string name="wrap_mode" value="repeat"/>
        </texture>
    </bsdf>
</scene>
"""

# As Mitsuba 0.5 and 0.6 wrote them.
KITCHEN = """<?xml version="1.0" encoding="utf-8"?>
<scene version="0.5.0" >
	<integrator type="path" >
		<integer name="maxDepth" value="65" />
	</integrator>
	<sensor type="perspective" >
		<float name="fov" value="60" />
		<transform name="toWorld" >
			<lookAt origin="0, -5, 2" target="0, 0, 0.7" up="0, 0, 1" />
		</transform>
		<sampler type="independent" >
			<integer name="sampleCount" value="64" />
		</sampler>
		<film type="hdrfilm" >
			<integer name="width" value="32" />
			<integer name="height" value="24" />
			<string name="fileFormat" value="openexr" />
			<string name="pixelFormat" value="rgb" />
			<boolean name="banner" value="false" />
			<rfilter type="gaussian" />
		</film>
	</sensor>
	<bsdf type="twosided" id="Floor" >
		<bsdf type="diffuse" >
			<texture name="reflectance" type="bitmap" >
				<string name="filename" value="assets/wood.png" />
				<string name="filterType" value="bilinear" />
				<float name="uscale" value="3" />
				<float name="vscale" value="3" />
			</texture>
		</bsdf>
	</bsdf>
	<bsdf type="dielectric" id="Glass" >
		<float name="intIOR" value="1.5" />
		<float name="extIOR" value="1" />
	</bsdf>
	<bsdf type="twosided" id="Steel" >
		<bsdf type="roughconductor" >
			<float name="alpha" value="0.15" />
			<string name="distribution" value="ggx" />
			<rgb name="specularReflectance" value="0.8, 0.8, 0.8" />
			<rgb name="eta" value="1.65746, 0.880369, 0.521229" />
			<rgb name="k" value="9.22387, 6.26952, 4.837" />
		</bsdf>
	</bsdf>
	<bsdf type="mask" id="Curtain" >
		<float name="opacity" value="0.7" />
		<bsdf type="twosided" >
			<bsdf type="diffuse" >
				<rgb name="reflectance" value="0.8, 0.7, 0.6" />
			</bsdf>
		</bsdf>
	</bsdf>
	<bsdf type="thindielectric" id="Pane" />
	<shape type="rectangle" >
		<transform name="toWorld" >
			<scale x="4" y="4" />
		</transform>
		<ref id="Floor" />
	</shape>
	<shape type="obj" >
		<string name="filename" value="assets/body.obj" />
		<transform name="toWorld" >
			<scale value="0.6" />
			<translate x="-1" z="0.8" />
		</transform>
		<ref id="Steel" />
	</shape>
	<shape type="cube" >
		<transform name="toWorld" >
			<scale value="0.4" />
			<translate x="0.6" z="0.5" />
		</transform>
		<ref id="Glass" />
	</shape>
	<shape type="rectangle" >
		<transform name="toWorld" >
			<rotate x="1" angle="90" />
			<translate x="2" y="1" z="1" />
		</transform>
		<ref id="Curtain" />
	</shape>
	<shape type="rectangle" >
		<transform name="toWorld" >
			<rotate x="1" angle="90" />
			<translate x="-2" y="1.5" z="1" />
		</transform>
		<ref id="Pane" />
	</shape>
	<shape type="disk" >
		<transform name="toWorld" >
			<rotate x="1" angle="180" />
			<translate z="4" />
		</transform>
		<emitter type="area" >
			<rgb name="radiance" value="12, 11, 9" />
		</emitter>
	</shape>
	<emitter type="constant" >
		<spectrum name="radiance" value="0.3" />
	</emitter>
</scene>
"""

SCENES = {"cornell": CORNELL, "veach": VEACH, "preview": PREVIEW, "kitchen": KITCHEN}


def write_gallery(folder):
    """Scene files by name, with all that they refer to."""
    for name in ("meshes", "assets", "assets/materials"):
        (folder / name).mkdir()
    for name, turn in {
        "floor": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        "ceiling": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        "back": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "right": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        "left": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    }.items():
        _quad(folder / f"meshes/{name}.obj", turn, 1.0, -1.0)
    _quad(folder / "meshes/luminaire.obj", [[1, 0, 0], [0, 0, 1], [0, -1, 0]], 0.25, -0.99)
    _quad(folder / "meshes/plate.obj", [[1, 0, 0], [0, 0, -1], [0, 1, 0]], 1.0, 0.0)
    body = displaced_sphere(3, amplitude=0.1, frequency=4.0)
    _obj(folder / "assets/body.obj", np.asarray(body.vertices), np.asarray(body.faces), uvs=True)
    _ply(folder / "assets/stand.ply", sphere(2))
    random = np.random.default_rng(0)
    write_image(folder / "assets/wood.png", random.random((8, 8, 3)).astype(np.float32) * 0.6)
    sky = np.linspace(1, 0.1, 8)[:, None, None] * np.array([0.4, 0.5, 0.7]) * np.ones((8, 16, 1))
    sky[2, 4] = (20, 18, 14)
    write_image(folder / "assets/envmap.pfm", sky.astype(np.float32))
    (folder / "assets/materials/lacquer.xml").write_text(LACQUER)
    for name, text in SCENES.items():
        (folder / f"{name}.xml").write_text(text)
    return {name: folder / f"{name}.xml" for name in SCENES}


def _quad(path, turn, half, offset):
    """A square [-half, half]², `offset` along its normal from the origin; columns of `turn` are u, v and the normal."""
    corners = np.array([[-half, -half, offset], [half, -half, offset], [half, half, offset], [-half, half, offset]])
    points = corners @ np.array(turn, float)
    lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in points]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "f 1/1 2/2 3/3 4/4"]
    path.write_text("\n".join(lines) + "\n")


def _obj(path, points, faces, uvs):
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    lines += [f"vt {x:.6f} {y:.6f}" for x, y, _ in points] if uvs else []
    lines += ["f " + " ".join(f"{i + 1}/{i + 1}" for i in face) for face in faces]
    path.write_text("\n".join(lines) + "\n")


def _ply(path, mesh):
    points, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
    header += f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(f"{c:.6f}" for c in point) for point in points]
    rows += ["3 {} {} {}".format(*face) for face in faces]
    path.write_text(header + "\n".join(rows) + "\n")
