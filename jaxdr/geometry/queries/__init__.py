"""Ray and edge queries: which face a ray hits, whether a ray is free, which edges lie near a point or cross a chord.

Another query finds faces that pass through each other.

The library calls `api`. It detaches the inputs, chooses an implementation, and batches under `vmap`. `records` has the
types of inputs and answers. Answers have no derivative; the caller evaluates hits again in JAX. The implementations are
`embree` (nearest hits and occlusion on CPUs), `warp` (all queries, on CPU and GPU) and `jax` (all queries in plain JAX,
the reference). `bvh_cache` keeps the structures of the first two, by the content of the geometry.
"""

from jaxdr.geometry.queries.api import ANSWER as ANSWER
from jaxdr.geometry.queries.api import CHOICES as CHOICES
from jaxdr.geometry.queries.api import IMPLEMENTATIONS as IMPLEMENTATIONS
from jaxdr.geometry.queries.api import check_rays as check_rays
from jaxdr.geometry.queries.api import closest_hit as closest_hit
from jaxdr.geometry.queries.api import closest_silhouettes as closest_silhouettes
from jaxdr.geometry.queries.api import draw_edges as draw_edges
from jaxdr.geometry.queries.api import edge_candidates as edge_candidates
from jaxdr.geometry.queries.api import edge_tree as edge_tree
from jaxdr.geometry.queries.api import face_intersections as face_intersections
from jaxdr.geometry.queries.api import occluded as occluded
from jaxdr.geometry.queries.api import point_candidates as point_candidates
from jaxdr.geometry.queries.api import projections as projections
from jaxdr.geometry.queries.api import rematerialised as rematerialised
from jaxdr.geometry.queries.api import sector_crossings as sector_crossings
from jaxdr.geometry.queries.api import silhouettes as silhouettes
from jaxdr.geometry.queries.records import BESIDE as BESIDE
from jaxdr.geometry.queries.records import NO_GROUP as NO_GROUP
from jaxdr.geometry.queries.records import UNBOUNDED as UNBOUNDED
from jaxdr.geometry.queries.records import Candidates as Candidates
from jaxdr.geometry.queries.records import ClosestSilhouettes as ClosestSilhouettes
from jaxdr.geometry.queries.records import ConeQuery as ConeQuery
from jaxdr.geometry.queries.records import DrawnEdges as DrawnEdges
from jaxdr.geometry.queries.records import EdgePoints as EdgePoints
from jaxdr.geometry.queries.records import EdgeSet as EdgeSet
from jaxdr.geometry.queries.records import EdgeTable as EdgeTable
from jaxdr.geometry.queries.records import FaceIntersections as FaceIntersections
from jaxdr.geometry.queries.records import Geometry as Geometry
from jaxdr.geometry.queries.records import Hit as Hit
from jaxdr.geometry.queries.records import Lines as Lines
from jaxdr.geometry.queries.records import Projections as Projections
from jaxdr.geometry.queries.records import Rays as Rays
from jaxdr.geometry.queries.records import SectorCrossings as SectorCrossings
from jaxdr.geometry.queries.records import SectorQuery as SectorQuery
from jaxdr.geometry.queries.records import StripQuery as StripQuery
