"""Reading glTF files: `document`, `accessors`, `nodes`, `primitives`; `parts` has all triangles of a file."""
