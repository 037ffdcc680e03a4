"""From photographs with known cameras to a mesh with textures and its light: `jaxdr reconstruct`."""
