"""Photographs as a notebook shows them: how many there are, their sizes, and a few small pictures."""

import math

from jaxdr.html_summary import escaped, summary, thumbnail
from jaxdr.images import to_srgb
from jaxdr.views.record import View, Views
from jaxdr.views.summary import summary as in_words

PICTURES, PIXELS = 6, 128  # how many are shown, and the length of their longer side


def views_html(views: Views) -> str:
    """The summary of photographs and the first of them, as HTML. A picture that can't be read is named only."""
    if not views.views:
        return summary("jaxdr.Views", "<br>no photographs")
    left = len(views.views) - PICTURES
    more = f"<br>… and {left} more" if left > 0 else ""
    pictures = "".join(map(_picture, views.views[:PICTURES]))
    return summary("jaxdr.Views", f"<br>{escaped(in_words(views))}<br>", pictures, more)


def _picture(view: View) -> str:
    words = f"{view.name} (held out)" if view.held_out else view.name
    try:
        image = view.over_black
    except ValueError:  # a notebook shows what it can; whoever needs the picture is told
        return f"<br>{escaped(words)}: can't be read"
    each = math.ceil(max(image.shape[:2]) / PIXELS)
    return thumbnail(to_srgb(image[::each, ::each]), words)
