"""Many bounces in a white box, and fine tessellation."""

from jaxdr.geometry import shapes
from tests.stability.case import DIRECT_ONLY, Case, Expected
from tests.stability.shadows import ALONG, BOTH, NOISY, SHADE
from tests.stability.stage import camera as view
from tests.stability.stage import cube, grey, lamp, table

WHITE = 0.9
SIZES = {"1k": 1_000, "100k": 100_000, "1M": 1_000_000}  # faces, about


OFFSET = Expected(
    "biased",
    "visibility rays pass an edge at 1.2e-5 of the largest coordinate, so an edge that is hidden by less than this "
    "counts as visible. With four times the distance, 1.016 at 100 thousand faces becomes 1.038 (KernelDensity: "
    "1.014, 1.036)",
)


def white_box(depth: int) -> Case:
    """A cube in a closed white room with a lamp under its ceiling."""
    scene = table(
        cube(0.7, (0.1, 0.2, 0.8)),
        shapes.box([2.6, 2.6, 2.6], (0.0, 0.0, 1.3)),
        lamp(0.8, (0.0, 0.2, 2.55), (0.0, 0.2, 0.0)),
        view=view((0.0, -1.25, 1.3), (0.0, 0.2, 0.9), 70.0),
        ground_bsdf=grey(WHITE),
    )
    return Case(
        "white_box",
        "interreflection",
        f"a cube in a closed room that reflects {WHITE:.0%}",
        "variance grows with the depth (own list)",
        scene,
        {"blocker.vertices": ALONG},
        0.02,
        max_depth=depth,
        reference_spp=256,
        batches=48,
        expected={"RednerWAS": DIRECT_ONLY} | NOISY,
    )


def tessellated(name: str, faces: int) -> Case:
    """The shadow of a bumpy ball of so many faces."""

    def made():
        ball = shapes.displaced_sphere(radius=0.35, center=(0.0, 0.0, 1.0), vertex_count=faces // 2 + 2)
        return table(ball, view=view(*SHADE, 45.0))

    return Case(
        f"tessellation_{name}",
        "tessellation",
        f"shadow of a bumpy ball of about {faces:,} faces",
        "13 to 17 % too large with all edges of Eq. 18 of the 2026 paper (own finding); tiny edges",
        made,
        {"blocker.vertices": ALONG},
        0.02,
        expected=BOTH,
    )


def cases() -> list[Case]:
    """From cheap to dear."""
    return [white_box(6), *(tessellated(name, faces) for name, faces in SIZES.items())]
