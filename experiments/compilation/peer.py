"""Mitsuba's half: README's scene with the same triangles, flat shaded, behind a box filter."""

import time

import numpy as np


class Peer:
    """The scene of `scenes.scene_of("plain", film)` in Mitsuba; `folder` takes its meshes.

    Needs an LLVM that Dr.Jit finds (DRJIT_LIBLLVM_PATH).
    """

    def __init__(self, scene, folder):
        import drjit as dr
        import mitsuba as mi

        from experiments.forward_images.files import write_ply
        from jaxdr import Mesh

        mi.set_variant("llvm_ad_rgb")
        mi.set_log_level(mi.LogLevel.Error)
        self.dr, self.mi = dr, mi

        def diffuse(*color):
            return {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}}

        radiance = {"type": "rgb", "value": [20.0] * 3}
        looks = {
            "ball": {"bsdf": diffuse(0.8, 0.5, 0.3)},
            "floor": {"bsdf": {"type": "twosided", "bsdf": diffuse(0.5, 0.5, 0.5)}},
            "lamp": {"bsdf": diffuse(0.0, 0.0, 0.0), "emitter": {"type": "area", "radiance": radiance}},
        }
        for name, look in looks.items():
            path, mesh = folder / f"{name}.ply", scene.shapes[name].mesh
            write_ply(path, Mesh(mesh.vertices, mesh.faces))  # without UVs, for which it would split vertices
            look |= {"type": "ply", "filename": str(path), "face_normals": True}
        _, _, width, height = scene.camera.film.window
        sensor = {
            "type": "perspective",
            "fov": float(scene.camera.fov),
            "to_world": mi.ScalarTransform4f(np.asarray(scene.camera.to_world, float)),
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        }
        self.scene = mi.load_dict({"type": "scene", "sensor": sensor} | looks)
        self.parameters = mi.traverse(self.scene)
        self.name = "ball.vertex_positions"
        self.rest = dr.unravel(mi.Point3f, self.parameters[self.name])
        dr.eval(self.rest)

    def image(self, integrator: dict, spp: int, seed: int):
        """([H, W, 3] image, seconds)."""
        made = self.mi.load_dict(integrator)
        start = time.perf_counter()
        image = np.array(self.mi.render(self.scene, integrator=made, spp=spp, seed=seed))  # copying it waits for it
        return image[..., :3], time.perf_counter() - start

    def gradient(self, integrator: dict, spp: int, seed: int):
        """([3] gradient of the image's mean square by an offset of the ball, seconds), the image included."""
        dr, mi = self.dr, self.mi
        made = mi.load_dict(integrator)
        start = time.perf_counter()
        offset = mi.Vector3f(0.0)
        dr.enable_grad(offset)
        self.parameters[self.name] = dr.ravel(self.rest + offset)
        self.parameters.update()
        image = mi.render(self.scene, self.parameters, integrator=made, spp=spp, seed=seed)
        dr.backward(dr.mean(dr.square(image), axis=None))
        return np.array(dr.grad(offset)).ravel(), time.perf_counter() - start
