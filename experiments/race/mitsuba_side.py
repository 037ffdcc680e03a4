"""Mitsuba's half: the same run, with images and gradients of views by Mitsuba."""

from typing import Any

import jax
import numpy as np

from jaxdr.optimize.phase import Programs
from jaxdr.optimize.problem import OBJECT
from jaxdr.optimize.shape import ShapeTask

POSE, VERTICES = "sensor.to_world", f"{OBJECT}.vertex_positions"


class MitsubaTask(ShapeTask):
    """`ShapeTask` whose programs call Mitsuba. All else is the same code: optimiser, remeshing, levels, pictures."""

    def level_programs(self) -> list[Programs]:
        views = MitsubaViews(self.problem.scene, self.config)
        return [Programs(views.image, Gradients(views, stage)) for stage in self.config.stages()]


class Gradients:
    """What `jaxdr.optimize.devices.Divided` is for jaxdr's own gradients; for a level's samples per pixel."""

    def __init__(self, views: "MitsubaViews", stage: Any):
        self.views, self.samples = views, (stage.image, stage.gradient)

    def __call__(self, mesh, items) -> list[tuple[float, np.ndarray]]:
        return [self.views.gradient(mesh, *item, *self.samples) for item in items]

    def compile(self, mesh, item) -> None:
        """Nothing: Dr.Jit compiles at the first call, and its calls come from one thread."""


class MitsubaViews:
    """A scene of `jaxdr.optimize.problem` in Mitsuba: same triangles, same normals, box filter.

    Images are those of `path`, gradients those of `direct_projective` or `prb_projective` without guiding: a guide
    costs seconds for each gradient. Needs an LLVM that Dr.Jit finds (DRJIT_LIBLLVM_PATH).
    """

    def __init__(self, scene, config):
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        mi.set_log_level(mi.LogLevel.Error)
        self.dr, self.mi, self.config = dr, mi, config
        self.others = {name: self._shape(name, shape) for name, shape in scene.shapes.items() if name != OBJECT}
        self.object = scene.shapes[OBJECT]
        self.sensor = {
            "type": "perspective",
            "fov": float(scene.camera.fov),
            "to_world": mi.ScalarTransform4f(np.asarray(scene.camera.to_world, float)),
            "film": self._film(scene.camera.film.height),
        }
        if scene.environment is not None:
            self.others["environment"] = {"type": "constant", "radiance": self._color(scene.environment.radiance)}
        depth = int(config.integrator.max_depth)
        direct = {"type": "direct_projective", "guiding": "none"}
        deep = {"type": "prb_projective", "guiding": "none", "max_depth": depth, "rr_depth": 1000}
        self.of_gradient = mi.load_dict(direct if depth == 2 else deep)
        self.of_image = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 1000})
        self.faces, self.scene, self.parameters = None, None, None

    def image(self, mesh, to_world, key, spp) -> np.ndarray:
        """[H, W, 3] image of a view."""
        self._show(mesh, to_world)
        found = self.mi.render(self.scene, integrator=self.of_image, spp=spp, seed=seed_of(key))
        return np.array(found)[..., :3]

    def gradient(self, mesh, to_world, target, key, image_spp, gradient_spp) -> tuple[float, np.ndarray]:
        """(loss of a view, its [V, 3] gradient): image and derivative have independent samples, as in jaxdr."""
        dr, mi = self.dr, self.mi
        self._show(mesh, to_world)
        dr.enable_grad(self.parameters[VERTICES])
        self.parameters.update()
        seeds = {"seed": seed_of(key), "seed_grad": seed_of(jax.random.fold_in(key, 1))}
        samples = {"spp": image_spp, "spp_grad": gradient_spp}
        image = mi.render(self.scene, self.parameters, integrator=self.of_gradient, **samples, **seeds)
        error = image - mi.TensorXf(np.asarray(target, np.float32))
        loss = dr.mean(dr.abs(error) if self.config.optimizer.loss == "l1" else dr.square(error), axis=None)
        dr.backward(loss)
        gradient = np.array(dr.grad(self.parameters[VERTICES])).reshape(-1, 3)
        dr.disable_grad(self.parameters[VERTICES])
        return float(np.array(loss).ravel()[0]), gradient

    def _show(self, mesh, to_world) -> None:
        """The mesh and the camera of the next rendering. A new topology is a new scene."""
        faces = np.asarray(mesh.faces)
        if self.faces is None or not np.array_equal(faces, self.faces):
            self.faces = faces
            shape = self._shape(OBJECT, self.object, mesh)
            self.scene = self.mi.load_dict(
                {"type": "scene", "sensor": self.sensor, OBJECT: shape, **self.others},
            )
            self.parameters = self.mi.traverse(self.scene)
            self.parameters.keep([VERTICES, POSE])
        self.parameters[VERTICES] = self.mi.Float(np.asarray(mesh.vertices, np.float32).ravel())
        self.parameters[POSE] = self.mi.Transform4f(np.asarray(to_world, float))
        self.parameters.update()

    def _shape(self, name, shape, mesh=None):
        """A mesh of Mitsuba with the looks of one of jaxdr's shapes."""
        mi, mesh = self.mi, shape.mesh if mesh is None else mesh
        twosided = hasattr(shape.bsdf, "bsdf")
        reflectance = (shape.bsdf.bsdf if twosided else shape.bsdf).reflectance
        bsdf = {"type": "diffuse", "reflectance": self._color(reflectance)}
        properties = mi.Properties()
        properties["face_normals"] = flat = mesh.normal_group_count == 0
        properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": bsdf} if twosided else bsdf)
        if shape.emitter is not None:
            radiance = self._color(shape.emitter.radiance)
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
        made = mi.Mesh(name, len(vertices), len(faces), has_vertex_normals=not flat, props=properties)
        parameters = mi.traverse(made)
        parameters["vertex_positions"] = mi.Float(vertices.ravel())
        parameters["faces"] = mi.UInt32(faces.ravel())
        parameters.update()
        return made

    def _film(self, size):
        settings = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb"}
        return settings | {"rfilter": {"type": "box"}, "component_format": "float32"}

    @staticmethod
    def _color(value):
        return {"type": "rgb", "value": [float(c) for c in np.broadcast_to(np.asarray(value, float), 3)]}


def seed_of(key) -> int:
    """A seed for Mitsuba from a random key of JAX."""
    return int(jax.random.key_data(key)[-1]) & 0x7FFFFFFF
