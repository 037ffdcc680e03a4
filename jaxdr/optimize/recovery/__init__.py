"""Recovery of named scene parameters from images: the config, its scenes, two optimisers, and the loop."""
