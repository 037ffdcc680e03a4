"""Mitsuba 3 scene files: `load.load_mitsuba` reads one.

- `document` reads the XML, with variables, includes and references, into a tree of `element.Element`s.
- `upgrade` brings files of Mitsuba 0.x up to date.
- `bsdfs`, `materials`, `textures`, `emitters`, `shapes` and `sensors` hold a table of plugins each: names, and
  functions from an element to an object.
- `xml.Properties` reads the parameters of an element.
"""
