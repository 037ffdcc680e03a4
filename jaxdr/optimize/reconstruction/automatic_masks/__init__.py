"""Masks of photographs that have none, from where cameras look, sparse points, and agreement between photographs.

`region`: where the object is. `pictures`: it is cut out of each photograph by its colours (GrabCut). `consensus`: the
solid on which most photographs agree. `find`: rounds of both.
"""
