"""All kinds of inputs, by name."""

from tests.fuzz import runs

KINDS = {kind.name: kind for part in (runs,) for kind in part.kinds()}
