"""Boundary estimators: derivatives of what is seen, where visibility changes. Adding one: a file, and a line here."""
