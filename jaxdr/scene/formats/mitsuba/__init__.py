"""Mitsuba 3 scene files: `load.load_mitsuba` reads one.

- `parse` reads the XML, with `variables` and includes, into a tree of `element.Element`s, and `document` puts in what
  references stand for. Both have limits: a small file can stand for a scene of any size.
- `number` reads all numbers, and checks their range.
- `upgrade` brings files of Mitsuba 0.x up to date.
- `bsdfs`, `materials`, `textures`, `emitters`, `shapes` and `sensors` hold a table of plugins each: names, and
  functions from an element to an object.
- `xml.Properties` reads the parameters of an element.
"""
