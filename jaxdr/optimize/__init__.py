"""Losses, preconditioning, remeshing, metrics, and the optimisation loop with its checkpoints."""
