"""Scene files of other programs: `mitsuba` (XML) and `gltf`."""
