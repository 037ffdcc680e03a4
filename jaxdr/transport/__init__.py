"""Random numbers, first hits, path tracing."""
