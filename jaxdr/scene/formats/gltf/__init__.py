"""glTF files as scenes: `load.load_gltf` reads one. How they are stored is in `jaxdr.geometry.gltf`."""
