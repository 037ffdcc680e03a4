"""The scenes of the sweep: a black ball in a mirror under a constant sky, and the reference scene with a mirror."""

from experiments.equal_time.cases import Case, replaced_once, write_scene

BALL = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="perspective">
        <string name="fov_axis" value="x"/>
        <float name="fov" value="24"/>
        <transform name="to_world"><lookat origin="0, -3, 1.6" target="0, -1, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="64"/><integer name="height" value="64"/>
            <string name="pixel_format" value="rgb"/><rfilter type="box"/>
        </film>
        <sampler type="independent"/>
    </sensor>
    <shape type="ply" id="ball">
        <string name="filename" value="ball.ply"/>
        <boolean name="face_normals" value="true"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf>
    </shape>
    <shape type="rectangle" id="mirror">
        <transform name="to_world"><scale value="6"/></transform>
        <bsdf type="roughconductor">
            <string name="distribution" value="ggx"/><float name="alpha" value="{alpha}"/>
            <string name="material" value="none"/>
        </bsdf>
    </shape>
    <emitter type="constant"><rgb name="radiance" value="1, 1, 1"/></emitter>
</scene>
"""


def ball(alpha):
    """A case of `equal_time`: nothing but the boundary term, of what a mirror of this roughness shows."""
    return Case(f"ball_{alpha}", "", "ball", 0.01, 64, smooth=False, directly_visible=False)


def mirror_spot(alpha):
    """A case of `equal_time`: all terms, seen directly and in a mirror."""
    return Case(f"mirror_spot_{alpha}", "mirror_spot", "spot", 0.005, 96, False, directly_visible=True, max_depth=4)


def write_ball(alpha, folder):
    """The scene file; returns its path."""
    import trimesh

    import jaxdr as jd

    folder.mkdir(parents=True, exist_ok=True)
    mesh = jd.shapes.displaced_sphere(3, radius=0.5, center=(0.0, 0.5, 1.2))
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(folder / "ball.ply")
    path = folder / "scene.xml"
    path.write_text(BALL.format(alpha=alpha))
    return path


def write_mirror_spot(alpha, oracle, folder):
    """The reference scene with a box film and a mirror of this roughness; returns the path of the file."""
    path = write_scene(mirror_spot(alpha), oracle, folder)
    path.write_text(replaced_once(path.read_text(), r'(<float name="alpha" value=)"[^"]*"', rf'\1"{alpha}"', path))
    return path
