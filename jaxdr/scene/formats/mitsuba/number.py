"""Numbers in the text of a Mitsuba scene file: the one place where their range is checked."""

import re

from jaxdr.untrusted import LARGEST_WHOLE, finite, shortened, whole


def floats(text: str, *counts: int) -> list[float]:
    """Finite numbers separated by spaces or commas; `counts` are the allowed numbers of them, and none means any.

    Raises ValueError for anything else, and for a number beyond `LARGEST`.
    """
    values = [number(word, text) for word in re.split(r"\s*,\s*|\s+", text.strip())]
    if counts and len(values) not in counts:
        allowed = f"{min(counts)} to {max(counts)}" if len(counts) > 3 else " or ".join(map(str, counts))
        raise ValueError(f"expected {allowed} numbers, got {shortened(text)}")
    return values


def number(word: str, text: str) -> float:
    """A word as a finite number; `text` is what it is from, for the error. Raises ValueError for anything else."""
    try:
        if not word.isascii() or "_" in word:  # Python would read ٣ and 1_0, Mitsuba does not
            raise ValueError
        value = float(word)
    except ValueError:
        raise ValueError(f"expected numbers, got {shortened(text)}") from None
    return finite(value, shortened(text))


def integer(text: str, low: int = -LARGEST_WHOLE, high: int = LARGEST_WHOLE) -> int:
    """A whole number within a range. Raises ValueError for anything else."""
    text = text.strip()
    if not re.fullmatch(r"[+-]?[0-9]+", text):
        raise ValueError(f"expected an integer, got {shortened(text)}")
    if len(text) > 100:  # Python takes long for the digits of long numbers
        raise ValueError(f"a whole number of {len(text)} digits is too large")
    return whole(int(text), text, low, high)
