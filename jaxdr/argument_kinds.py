"""Arguments of the wrong kind get one clear line, wherever they are given: kinds are the annotations of parameters.

`checked` stands before public functions and constructors. It looks at kinds alone. Ranges, shapes and what goes
together are for the function itself. A look at an argument is cheap, and never waits for a device but for a single
number that has to be known.
"""

import inspect
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from itertools import chain, repeat
from os import PathLike
from pathlib import PurePath
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import AbstractArray, PRNGKeyArray, jaxtyped
from numpy.typing import ArrayLike

Checked = TypeVar("Checked", bound=Callable)

NUMBERS = "made of numbers"
LONGEST = 60  # characters of a value in a message
LARGEST = 2**63  # whole numbers are below
MANY = 1000  # rows of a list are looked at one by one up to here
ARRAY_LIKE, KEYS = (frozenset(typing.get_args(union)) for union in (ArrayLike, PRNGKeyArray))
# How a message names a class of the package, where a name alone would not say what to write.
SUCH_AS = {
    "BSDF": "a BSDF such as jaxdr.Diffuse()",
    "BSDF | TwoSided": "a BSDF such as jaxdr.Diffuse()",
    "Camera": "a camera such as jaxdr.Perspective(...)",
    "Environment": "an environment such as jaxdr.ConstantEnvironment()",
    "Integrator": "an integrator such as jaxdr.PathTracer()",
    "Mesh": "a jaxdr.Mesh, as of jaxdr.shapes or jaxdr.load_mesh",
    "ReconstructionFilter": "a pixel filter such as jaxdr.Box()",
    "ReusedGuides": "guides of jaxdr.build_guides",
    "Texture": "a texture such as jaxdr.Bitmap(...)",
    "Views | Sequence": "the views of jaxdr.load_views",
}


class Kind(NamedTuple):
    """What an annotation asks for: `words` of messages, and `taken`, which returns a value that is right.

    The value that it returns may be another type of the same value, such as an int for 4.0. Raises `WrongKind` for any
    other value.
    """

    words: str
    taken: Callable[[Any], Any]


class WrongKind(Exception):
    """A value is not of a kind."""


def checked(function: Checked) -> Checked:
    """A function, or a class with its constructor, that raises ValueError for arguments of another kind.

    The message is one line. It names the function or class and the parameter, and says what was expected and given.
    """
    if isinstance(function, type):
        function.__init__ = checked(function.__init__)
        return typing.cast(Checked, function)
    known: list[tuple[list[str], str, dict[str, Kind]]] = []  # from the first call on: importing takes no longer

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if not known:
            known.append(_parameters(function))
        names, rest, kinds = known[0]
        owner = type(args[0]).__name__ if names[:1] == ["self"] and args else function.__name__
        # Values beyond the names are those of `*rest`, or for Python to refuse.
        pairs = zip(chain(names, repeat(rest)), args, strict=False)
        given = [_taken(kinds, name, value, owner) for name, value in pairs]
        named = {name: _taken(kinds, name, value, owner) for name, value in kwargs.items()}
        return function(*given, **named)

    return typing.cast(Checked, call)


def shown(value: Any) -> str:
    """A value in a few words, on one line."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, Tracer):
        return "a traced value"
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if any(kind.__module__.partition(".")[0] == "torch" for kind in type(value).__mro__):
        return f"a tensor of shape {list(shape or ())} ({dtype}); jaxdr.torch differentiates tensors"
    if dtype is not None and shape:
        return f"an array of shape {list(shape)} ({dtype})"
    if inspect.isroutine(value):
        return f"the function {value.__name__}"
    if not isinstance(value, bool | int | float | complex | str | bytes | Sequence | Mapping | PathLike | None):
        return repr(value.item()) if dtype is not None and shape == () else _of_type(value)
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python does not write whole numbers of more than 4,300 digits
        return "a number of thousands of digits"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def made_of_numbers(value: Any) -> bool:
    """Whether a value is a number, or an array or regular lists of numbers; no complex ones, and no True and False."""
    try:
        shape_of(value)
    except (WrongKind, TypeError, ValueError, RuntimeError):  # the last one from tensors that need a gradient
        return False
    return True


def shape_of(value: Any) -> tuple[int, ...]:
    """The shape of a number, an array or regular lists. Raises `WrongKind` for what is not made of numbers."""
    if isinstance(value, bool | str | bytes) or isinstance(value, type):
        raise WrongKind
    if isinstance(value, int | float):
        if isinstance(value, int) and not abs(value) < LARGEST:
            raise WrongKind
        return ()
    if isinstance(value, list | tuple) and len(value) > MANY:
        value = np.asarray(value)  # raises ValueError where rows differ
    if isinstance(value, list | tuple):
        shapes = {shape_of(part) for part in value}
        if len(shapes) > 1:
            raise WrongKind
        return (len(value), *(shapes.pop() if shapes else ()))
    if not isinstance(value, jax.Array) and not isinstance(
        getattr(value, "dtype", None), np.dtype
    ):  # such as a tensor of another library
        value = np.asarray(value)
    dtype = value.dtype
    if not (jnp.issubdtype(dtype, jnp.integer) or jnp.issubdtype(dtype, jnp.floating)):
        raise WrongKind
    return tuple(value.shape)


def _taken(kinds: dict[str, Kind], name: str, value: Any, owner: str) -> Any:
    kind = kinds.get(name)
    if kind is None:
        return value
    try:
        return kind.taken(value)
    except WrongKind:
        got = shown(value)
        if kind.words.startswith(NUMBERS) and isinstance(value, str | PathLike) and PurePath(value).suffix:
            got += "; jaxdr.load_image reads files"
        raise ValueError(f"{owner}: {name} must be {kind.words}, got {got}") from None


def _parameters(function: Callable) -> tuple[list[str], str, dict[str, Kind]]:
    """(names of parameters by position, that of `*rest` or "", kinds of those whose annotation says one)."""
    parameters = inspect.signature(function).parameters.values()
    kinds = {p.name: _kind(p.annotation) for p in parameters if p.kind != p.VAR_KEYWORD}
    by_position = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    rest = next((p.name for p in parameters if p.kind == p.VAR_POSITIONAL), "")
    return by_position, rest, {name: kind for name, kind in kinds.items() if kind is not None}


def _kind(annotation: Any) -> Kind | None:
    """The kind that an annotation asks for; None where anything may be given, or the function looks itself."""
    if annotation in SIMPLE:
        return SIMPLE[annotation]
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        return _union(parts)
    if origin is typing.Literal:
        return Kind(f"one of {', '.join(map(str, parts))}", _kind_of(lambda value: value in parts, str))
    if origin is tuple:
        return _tuple(parts)
    if annotation is Mapping or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return _dictionary(parts[1] if parts else Any)
    if isinstance(origin, type) and issubclass(origin, Iterable) and parts:
        return _several(parts[0], origin)
    if Callable in (annotation, origin):
        return Kind("a function", _kind_of(lambda value: not isinstance(value, type), Callable))
    if isinstance(annotation, type) and issubclass(annotation, AbstractArray):
        return _array(annotation)
    if annotation in (inspect.Parameter.empty, Any, object) or not isinstance(annotation, type):
        return None
    name = annotation.__name__
    return Kind(SUCH_AS.get(name, f"{_article(name)} jaxdr.{name}"), _instance(annotation))


def _union(parts: tuple[Any, ...]) -> Kind | None:
    """One of several kinds. The numbers, strings and sequences of `ArrayLike` are one of them."""
    left = [part for part in parts if part is not type(None)]
    if set(left) >= ARRAY_LIKE:
        kinds = [Kind(NUMBERS, _numbers)]  # no strings, and `Sequence` is for type checkers
    elif set(left) == KEYS:
        kinds = [Kind("a random key such as jax.random.key(0)", _key)]
    elif set(left) == {str, PathLike}:
        kinds = [Kind("a path", _kind_of(lambda _: True, str, PathLike))]
    else:
        kinds = [_kind(part) for part in left]
        if None in kinds:
            return None
    names = " | ".join(getattr(part, "__name__", "") for part in left)
    words = SUCH_AS.get(names, " or ".join(dict.fromkeys(kind.words for kind in kinds if kind)))

    def taken(value: Any) -> Any:
        for kind in kinds:
            try:
                return kind.taken(value) if kind else value
            except WrongKind:
                continue
        raise WrongKind

    if len(left) == len(parts):
        return Kind(words, taken)
    return Kind(f"{words}, or None", lambda value: None if value is None else taken(value))


def _tuple(parts: tuple[Any, ...]) -> Kind | None:
    """So many values, each of a kind, or any number of one kind."""
    if parts[-1] is Ellipsis:
        return _several(parts[0], tuple)
    kinds = [_kind(part) for part in parts]

    def taken(value: Any) -> tuple:
        if (
            not isinstance(value, Sequence | np.ndarray | jax.Array)
            or isinstance(value, str)
            or len(value) != len(kinds)
        ):
            raise WrongKind
        return tuple(kind.taken(part) if kind else part for kind, part in zip(kinds, value, strict=True))

    return Kind(f"{COUNTED[len(parts)]} {_plural(parts[0])}", taken)


def _several(part: Any, origin: type) -> Kind | None:
    """Any number of values of one kind."""
    kind = _kind(part)

    def taken(value: Any) -> Any:
        if not isinstance(value, origin) or isinstance(value, str | bytes | np.ndarray | jax.Array | type):
            raise WrongKind
        found = tuple(value)  # what can be gone through only once, too
        for inner in found:
            if kind:
                kind.taken(inner)
        return found

    return Kind(f"a list of {_plural(part)}", taken)


def _dictionary(part: Any) -> Kind:
    """Values of one kind by name."""
    kind = None if set(typing.get_args(part)) >= ARRAY_LIKE else _kind(part)  # of numbers the function tells the name

    def taken(value: Any) -> Any:
        if not isinstance(value, Mapping):
            raise WrongKind
        for inner in value.values():
            if kind:
                kind.taken(inner)
        return value

    of = "" if part is Any else f" of {_plural(part)}"
    return Kind(f"a dictionary{of} by name, such as {{'ball': ...}}", taken)


def _plural(part: Any) -> str:
    names = {str: "names", int: "whole numbers", bool: "flags", float: "numbers"}
    if set(typing.get_args(part)) >= ARRAY_LIKE:
        return "numbers"
    if any(isinstance(each, type) and issubclass(each, AbstractArray) for each in (part, *typing.get_args(part))):
        return "arrays"
    return names.get(part) or f"jaxdr.{getattr(part, '__name__', part)}"


def _array(annotation: Any) -> Kind:
    """Arrays of jaxtyping, whose axes agree by name only inside of the function."""
    dimensions = annotation.dim_str
    likewise = annotation.dtype[Any, dimensions]  # NumPy's arrays as well as JAX's
    kinds = jax.Array | np.ndarray  # not those of other libraries, which have shapes and types, too
    flags = annotation.dtype.__name__ == "Bool"
    axes = ", ".join("..." if axis[0] == "*" else axis for axis in dimensions.split())
    words = f"{'flags' if flags else 'floats'} of shape [{axes}]"

    def taken(value: Any) -> Any:
        with jaxtyped("context"):  # names of axes are not those of the caller's function
            if not (isinstance(value, kinds) and isinstance(value, likewise)):
                raise WrongKind
        return value

    return Kind(words, taken)


def _kind_of(fits: Callable[[Any], bool], *kinds: Any) -> Callable[[Any], Any]:
    """What takes the instances of some types that fit."""

    def taken(value: Any) -> Any:
        if not (isinstance(value, kinds) and fits(value)):
            raise WrongKind
        return value

    return taken


def _instance(kind: type) -> Callable[[Any], Any]:
    """What takes instances; for a protocol a class has all that its instances need as well."""
    return _kind_of(lambda value: not isinstance(value, type), kind)


def _numbers(value: Any) -> Any:
    if not made_of_numbers(value):
        raise WrongKind
    return value


def _number(value: Any) -> Any:
    """A number as it is. One of NumPy or JAX becomes Python's, unless it is traced."""
    if type(value) in (int, float):
        number = value if abs(value) < LARGEST else _as_float(value)
    elif isinstance(value, list | tuple) or not made_of_numbers(value) or np.shape(value) != ():
        raise WrongKind
    elif isinstance(value, Tracer):
        return value
    else:
        number = np.asarray(value).item()
    if number != number:
        raise WrongKind
    return number


def _as_float(value: float) -> float:
    try:
        return float(value)  # NumPy has no whole numbers of this size
    except OverflowError:
        raise WrongKind from None


def _whole(value: Any) -> int:
    """A whole number as an int, be it given as 4.0."""
    number = _number(value)
    if isinstance(number, Tracer) or not abs(number) < LARGEST or int(number) != number:
        raise WrongKind
    return int(number)


def _flag(value: Any) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise WrongKind
    return bool(value)


def _key(value: Any) -> Any:
    """One of JAX's types of keys, or the words of an old one."""
    is_array = isinstance(value, jax.Array | np.ndarray)
    if not is_array or not (jnp.issubdtype(value.dtype, jax.dtypes.prng_key) or value.dtype == jnp.uint32):
        raise WrongKind
    return value


def _article(name: str) -> str:
    return "an" if name[0] in "AEIOU" else "a"


def _of_type(value: Any) -> str:
    name = type(value).__name__
    return f"{_article(name)} {name}"


COUNTED = {2: "two", 3: "three", 4: "four"}
SIMPLE = {
    bool: Kind("True or False", _flag),
    int: Kind("a whole number", _whole),
    float: Kind("a number", _number),
    jax.Array: Kind("a number", _number),
    str: Kind("a name", _kind_of(lambda _: True, str)),
}
