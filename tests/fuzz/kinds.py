"""All kinds of inputs, by name."""

from tests.fuzz import folders, gltf_and_pictures, meshes, mitsuba, runs

KINDS = {kind.name: kind for part in (meshes, gltf_and_pictures, mitsuba, folders, runs) for kind in part.kinds()}
