"""Image file formats, one module for each: `read` and `write` pixel arrays, always with the top row first."""
