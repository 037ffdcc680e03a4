"""Photographs with known cameras: readers, renderings of the same views, and how well they agree."""
