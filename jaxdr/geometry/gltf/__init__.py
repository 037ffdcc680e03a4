"""glTF files as they are stored: `document`, `accessors`, `nodes`, `primitives`; `parts` is all their triangles."""
