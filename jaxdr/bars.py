"""Progress bars that suit their place: of the notebook in a notebook that has widgets, of the terminal elsewhere."""

import warnings

from tqdm import TqdmWarning
from tqdm.std import tqdm as terminal_bar

with warnings.catch_warnings():
    # A notebook without ipywidgets has no bars, but lines (`jaxdr.optimize.progress`). Nobody has to be told.
    warnings.simplefilter("ignore", TqdmWarning)
    from tqdm.auto import tqdm as tqdm
    from tqdm.autonotebook import tqdm as _chosen

IN_NOTEBOOK = _chosen is not terminal_bar  # whether bars are widgets
