"""jaxdr: differentiable rendering in JAX, with right derivatives where visibility changes."""

from importlib.metadata import PackageNotFoundError as _NotInstalled
from importlib.metadata import version as _version
from types import ModuleType as _ModuleType

from jaxdr.aovs import render_aovs as render_aovs
from jaxdr.boundary.all_silhouettes import AllSilhouettes as AllSilhouettes
from jaxdr.boundary.baselines.markov_chains import MarkovChains as MarkovChains
from jaxdr.boundary.baselines.quadric_sampling import QuadricSampling as QuadricSampling
from jaxdr.boundary.baselines.redner_was import RednerWAS as RednerWAS
from jaxdr.boundary.baselines.walk_on_caps import WalkOnCaps as WalkOnCaps
from jaxdr.boundary.by_kind import ByKind as ByKind
from jaxdr.boundary.guided_edges import GuidedEdges as GuidedEdges
from jaxdr.boundary.guided_edges.guide_report import guide_report as guide_report
from jaxdr.boundary.guided_edges.reused_guides import ReusedGuides as ReusedGuides
from jaxdr.boundary.guided_edges.reused_guides import build_guides as build_guides
from jaxdr.boundary.guided_edges.reused_guides import refit_guides as refit_guides
from jaxdr.boundary.kernel_density import KernelDensity as KernelDensity
from jaxdr.boundary.line_sampling import LineSampling as LineSampling
from jaxdr.boundary.shared.term import Chunk as Chunk
from jaxdr.boundary.shared.term import Context as Context
from jaxdr.boundary.shared.term import Term as Term
from jaxdr.boundary.warped_area import WarpedArea as WarpedArea
from jaxdr.compilation import jit as jit
from jaxdr.geometry import shapes as shapes
from jaxdr.geometry.load import load_mesh as load_mesh
from jaxdr.geometry.load import save_mesh as save_mesh
from jaxdr.geometry.mesh import Mesh as Mesh
from jaxdr.images import load_image as load_image
from jaxdr.images import write_image as write_image
from jaxdr.integrators import BidirectionalPathTracer as BidirectionalPathTracer
from jaxdr.integrators import PathTracer as PathTracer
from jaxdr.integrators.known_failures import EstimatorWarning as EstimatorWarning
from jaxdr.moving import Moving as Moving
from jaxdr.optimize import losses as losses
from jaxdr.optimize.adam import adam_uniform as adam_uniform
from jaxdr.optimize.chamfer import chamfer as chamfer
from jaxdr.optimize.field_aligned import remesh_field_aligned as remesh_field_aligned
from jaxdr.optimize.heartbeat import working as working
from jaxdr.optimize.preconditioner import LargeSteps as LargeSteps
from jaxdr.optimize.remesh import remesh as remesh
from jaxdr.plan.plan import plan as plan
from jaxdr.plan.report import Plan as Plan
from jaxdr.render import derivative_terms as derivative_terms
from jaxdr.render import render as render
from jaxdr.scene.bsdf import BSDF as BSDF
from jaxdr.scene.bsdf import Blend as Blend
from jaxdr.scene.bsdf import BumpMap as BumpMap
from jaxdr.scene.bsdf import Conductor as Conductor
from jaxdr.scene.bsdf import Dielectric as Dielectric
from jaxdr.scene.bsdf import Diffuse as Diffuse
from jaxdr.scene.bsdf import Mask as Mask
from jaxdr.scene.bsdf import NormalMap as NormalMap
from jaxdr.scene.bsdf import Phong as Phong
from jaxdr.scene.bsdf import Plastic as Plastic
from jaxdr.scene.bsdf import Principled as Principled
from jaxdr.scene.bsdf import RoughConductor as RoughConductor
from jaxdr.scene.bsdf import RoughDielectric as RoughDielectric
from jaxdr.scene.bsdf import RoughPlastic as RoughPlastic
from jaxdr.scene.bsdf import ThinDielectric as ThinDielectric
from jaxdr.scene.bsdf import TwoSided as TwoSided
from jaxdr.scene.bsdf.base import DeltaBSDF as DeltaBSDF
from jaxdr.scene.camera import Orthographic as Orthographic
from jaxdr.scene.camera import Perspective as Perspective
from jaxdr.scene.camera import ThinLens as ThinLens
from jaxdr.scene.camera import look_at as look_at
from jaxdr.scene.emitters import AreaEmitter as AreaEmitter
from jaxdr.scene.emitters import ConstantEnvironment as ConstantEnvironment
from jaxdr.scene.emitters import Environment as Environment
from jaxdr.scene.environment_map import EnvironmentMap as EnvironmentMap
from jaxdr.scene.film import Box as Box
from jaxdr.scene.film import Film as Film
from jaxdr.scene.film import Gaussian as Gaussian
from jaxdr.scene.film import Tent as Tent
from jaxdr.scene.formats.gltf.load import load_gltf as load_gltf
from jaxdr.scene.formats.gltf.save import save_gltf as save_gltf
from jaxdr.scene.formats.mesh_files import load_shape as load_shape
from jaxdr.scene.formats.mitsuba.load import load_mitsuba as load_mitsuba
from jaxdr.scene.lights import DeltaLight as DeltaLight
from jaxdr.scene.lights import DirectionalLight as DirectionalLight
from jaxdr.scene.lights import PointLight as PointLight
from jaxdr.scene.lights import Projector as Projector
from jaxdr.scene.lights import SpotLight as SpotLight
from jaxdr.scene.lights import TexturedSpotLight as TexturedSpotLight
from jaxdr.scene.move import move as move
from jaxdr.scene.scene import Scene as Scene
from jaxdr.scene.scene import Shape as Shape
from jaxdr.scene.textures import Bitmap as Bitmap
from jaxdr.scene.textures import Checkerboard as Checkerboard
from jaxdr.scene.textures import FaceColors as FaceColors
from jaxdr.scene.textures import Product as Product
from jaxdr.scene.textures import Texture as Texture
from jaxdr.scene.textures import VertexColors as VertexColors
from jaxdr.transport.radiance import Answers as Answers
from jaxdr.transport.radiance import Requests as Requests
from jaxdr.view.picture import Picture as Picture
from jaxdr.views.evaluate import evaluate_views as evaluate_views
from jaxdr.views.load import load_views as load_views
from jaxdr.views.record import View as View
from jaxdr.views.record import Views as Views
from jaxdr.views.rendering import render_views as render_views

try:
    __version__ = _version("jaxdr")
except _NotInstalled:  # run from a source tree that was never installed
    __version__ = "0.0.0"


def __dir__() -> list[str]:
    """The public names, as completion shows them: without the modules that are imported on the way."""
    hidden = {name for name, value in globals().items() if isinstance(value, _ModuleType)} - {"losses", "shapes"}
    return sorted(name for name in {*globals()} - hidden if not name.startswith("_") or name == "__version__")
