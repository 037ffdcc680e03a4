"""Mitsuba 3 scene files: `load.load_mitsuba` reads one.

`document` reads the XML with variables, includes and references into a tree of `element.Element`s; `upgrade` brings
files of Mitsuba 0.x up to date. Each of `bsdfs`, `materials`, `textures`, `emitters`, `shapes` and `sensors` holds a
table of plugins: a name and a function from an element to an object. `xml.Properties` reads an element's parameters.
"""
