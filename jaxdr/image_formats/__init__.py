"""Image file formats, one a file: `read` and `write` of pixel arrays, top row first, whatever the file's own order."""
