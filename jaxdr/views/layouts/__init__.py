"""Layouts of folders with photographs and cameras, one module each.

A module has a `NAME`; `files(folder)`, those that describe cameras, empty where a folder has another layout; and
`frames(folder)`, which raises ValueError, with the file, for what is damaged.
"""
