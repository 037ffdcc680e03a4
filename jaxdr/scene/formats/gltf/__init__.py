"""glTF files as scenes: `load.load_gltf` reads one. `jaxdr.geometry.gltf` reads the format of the files."""
