"""All kinds of inputs, by name."""

from tests.fuzz import gltf_and_pictures, runs

KINDS = {kind.name: kind for part in (gltf_and_pictures, runs) for kind in part.kinds()}
