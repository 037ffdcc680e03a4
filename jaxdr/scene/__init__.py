"""Camera, film, materials, emitters, the scene and its file formats."""
