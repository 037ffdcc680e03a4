"""What was read, in one line for people."""

from collections import Counter

from jaxdr.views.pictures import PictureFile
from jaxdr.views.record import View, Views


def summary(views: Views) -> str:
    """How many photographs there are, their sizes in the files and as they are used, lenses, and masks."""
    counts = f"{len(views.fitted)} + {len(views.held_out)} photographs to fit and to judge by"
    sizes = Counter(map(_sizes, views.views)).most_common()
    others = f" (and {len(sizes) - 1} other sizes)" if len(sizes) > 1 else ""
    bent = sorted({view.lens.model for view in views.views if not view.lens.straight})
    lens = f", distortion ({', '.join(bent)}) taken away" if bent else ""
    masked = "masks or alpha" if views.masked else "no masks"
    return f"{counts}, {sizes[0][0]}{others}{lens}, {masked}"


def _sizes(view: View) -> str:
    used = f"{view.width} x {view.height}"
    stored = f"{view.lens.width} x {view.lens.height}" if isinstance(view.picture, PictureFile) else used
    return used if stored == used else f"{stored} → {used}"
