"""What is fuzzed: a kind of input, with a valid example and the reader that users call."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple


class Kind(NamedTuple):
    """A kind of input.

    - `name`: short, such as "obj".
    - `write`: writes a valid example into an empty folder. It is small, and has every part that the reader looks at.
    - `read`: reads the folder as a user would. It returns, or raises ValueError, OSError or ImportError.
    - `damaged`: patterns of the files in the folder that are damaged.
    - `text`: whether they are text, so that words and numbers are changed besides bytes.
    """

    name: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]
    damaged: Sequence[str] = ("*",)
    text: bool = False
