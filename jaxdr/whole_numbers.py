"""Checks of arguments that count something."""


def whole(value) -> bool:
    """Whether a value is a concrete whole number of at least 1."""
    try:
        return not isinstance(value, str) and int(value) == value and int(value) >= 1
    except (TypeError, ValueError, OverflowError):  # None, NaN, infinity, a traced number, an array
        return False


def check_depth(caller: str, max_depth) -> None:
    """Raises ValueError for a longest path that is no whole number of segments, or has none."""
    if not whole(max_depth):
        raise ValueError(
            f"{caller}: max_depth must be at least 1 (emitters seen directly), and a whole number, got {max_depth!r}"
        )


def check_spp(caller: str, spp) -> None:
    """Raises ValueError for a number of samples that is no concrete positive whole number."""
    if not whole(spp):
        raise ValueError(f"{caller}: spp must be a positive whole number of samples per pixel, got {spp!r}")
