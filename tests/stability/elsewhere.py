"""Cases that are no derivative image of a scene here, and the tests that have them: (case, what is asserted, test)."""

HERE = "tests/stability/test_optimisation.py::"
ELSEWHERE = (
    (
        "start at the optimum",
        "for every vertex the mean gradient of the two-key loss is zero within its noise",
        HERE + "test_nothing_drifts_at_the_optimum",
    ),
    (
        "preconditioner off, large deformation",
        "with the preconditioner no edge folds; without it the run reports that the mesh collapses, and metrics count "
        "folds",
        HERE + "test_a_collapse_is_reported",
    ),
    ("remeshing an open mesh", "border and flatness are kept", HERE + "test_remeshing_an_open_mesh_keeps_its_border"),
    ("remeshing a UV-seamed mesh", "the mesh stays closed", HERE + "test_remeshing_a_seamed_mesh_opens_no_seam"),
    (
        "remeshing a mesh with split vertices",
        "the two halves stay together",
        HERE + "test_remeshing_split_vertices_keeps_the_seam_shut",
    ),
    (
        "a remeshing that fails",
        "the failure is reported, and the run continues with the old mesh",
        "tests/optimize/test_loop.py::test_a_failed_remeshing_is_said_and_survived",
    ),
    (
        "NaN in a loss or gradient",
        "the run stops, names view and step, and keeps the previous state",
        "tests/optimize/test_loop.py::test_nan_stops_the_run_and_is_named",
    ),
    (
        "faces without area in a file",
        "they are dropped, and one warning counts them",
        "tests/geometry/test_load.py::test_zero_area_faces_of_a_file_are_counted",
    ),
    (
        "thin faces",
        "they are kept; only faces without area after rounding are dropped",
        "tests/geometry/test_mesh.py::test_thin_faces_are_kept",
    ),
    (
        "normals of degenerate faces",
        "values and derivatives are finite",
        "tests/geometry/test_mesh.py::test_vertex_normals_and_their_derivative_are_finite_on_degenerate_faces",
    ),
    (
        "stale geometry under jit",
        "every geometry gets its own hits",
        "tests/geometry/queries/test_purity.py::test_every_geometry_gets_its_own_hits",
    ),
    (
        "rays along shared edges",
        "no ray slips through",
        "tests/geometry/queries/test_queries.py::test_watertight",
    ),
    (
        "more crossings than there is room for",
        "crossings are dropped at random without bias, with one warning",
        "tests/geometry/queries/test_sector.py::test_thinning_is_unbiased",
    ),
)
