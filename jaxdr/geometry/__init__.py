"""Meshes, procedural shapes and ray queries."""
