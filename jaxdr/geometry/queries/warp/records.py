"""The records of `queries` as Warp structs, and kernels as functions of JAX arrays in such records."""

import inspect
from collections.abc import Callable

import warp as wp
from warp import JaxCallableGraphMode, jax_callable

from jaxdr.quiet_warp import quiet


@wp.struct
class Geometry:
    vertices: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.vec3i)


@wp.struct
class Rays:
    origin: wp.array(dtype=wp.vec3)
    direction: wp.array(dtype=wp.vec3)
    reach: wp.array(dtype=float)


@wp.struct
class Lines:
    point: wp.array(dtype=wp.vec3)
    normal: wp.array(dtype=wp.vec3)
    depth: wp.array(dtype=float)
    shape: wp.array(dtype=int)


@wp.struct
class EdgeSet:
    ends: wp.array(dtype=wp.vec2i)
    faces: wp.array2d(dtype=int)
    opposite: wp.array2d(dtype=int)
    interior: wp.array(dtype=int)
    rank: wp.array(dtype=float)


@wp.struct
class EdgeTree:
    edge: wp.array(dtype=int)
    node: wp.array2d(dtype=wp.vec4)


@wp.struct
class EdgePoints:
    position: wp.array(dtype=wp.vec3)
    edge: wp.array(dtype=int)
    radius: wp.array(dtype=float)


@wp.struct
class StripQuery:
    apex: wp.array(dtype=wp.vec3)
    target: wp.array(dtype=wp.vec3)
    normal: wp.array(dtype=wp.vec3)
    scale: wp.array(dtype=float)
    widest: wp.array(dtype=float)


@wp.struct
class ConeQuery:
    apex: wp.array(dtype=wp.vec3)
    direction: wp.array(dtype=wp.vec3)
    normal: wp.array(dtype=wp.vec3)
    reach: wp.array(dtype=float)


@wp.struct
class EdgeTable:
    ends: wp.array2d(dtype=wp.vec3)
    normals: wp.array2d(dtype=wp.vec3)
    interior: wp.array(dtype=int)
    importance: wp.array(dtype=float)


@wp.struct
class Bundles:
    origin: wp.array(dtype=wp.vec3)
    direction: wp.array(dtype=wp.vec3)
    origin_rate: wp.array(dtype=wp.vec3)
    direction_rate: wp.array(dtype=wp.vec3)
    end: wp.array(dtype=float)


@wp.struct
class SectorQuery:
    apex: wp.array(dtype=wp.vec3)
    first: wp.array(dtype=wp.vec3)
    last: wp.array(dtype=wp.vec3)
    centre: wp.array(dtype=float)
    needed: wp.array(dtype=float)
    group: wp.array(dtype=int)


Numbers = wp.array(dtype=int)


def _arrays(kind) -> list:
    """[(field, type)] of a struct; for an array, one entry with its type."""
    return [("array", kind)] if isinstance(kind, wp.array) else [(name, v.type) for name, v in kind.vars.items()]


def _filled(kind, arrays):
    if isinstance(kind, wp.array):
        return next(arrays)
    record = kind()
    for name in kind.vars:
        setattr(record, name, next(arrays))
    return record


def _forget_stream(device) -> None:
    """Let Warp forget XLA's stream now, at the end of a callback.

    Warp (1.19) holds a lock during a callback. It knows XLA's stream from the beginning of a callback to the end of a
    Python object, and this end comes after the lock is released. So threads changed Warp's table of streams at the same
    time, and the process crashed.
    """
    if device.is_cuda:
        device.stream.__del__()
        device.stream.cuda_stream = None  # its own `__del__` then does nothing


class Call:
    """`body(*records, *outputs)`, host work that launches kernels, as a function of records of JAX arrays.

    `inputs` are the structs of the records (or types of single arrays), `outputs` the types of the output arrays. A
    record may have more fields than its struct, which takes fields by name. `kernels` is the Python module of the
    kernels.
    """

    def __init__(self, body: Callable, inputs: list, outputs: list, kernels):
        def function(*arrays):
            given = iter(arrays)
            try:
                body(*[_filled(kind, given) for kind in inputs], *given)
            finally:
                _forget_stream(arrays[0].device)

        self.inputs = inputs
        types = {f"{name}_{i}": of for i, kind in enumerate(inputs) for name, of in _arrays(kind)}
        self.outputs = [f"output_{i}" for i in range(len(outputs))]
        types |= dict(zip(self.outputs, outputs, strict=True))
        parameters = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in types]
        function.__signature__ = inspect.Signature(parameters)  # ty: ignore[unresolved-attribute]
        function.__annotations__ = types
        function.__name__ = function.__qualname__ = body.__name__
        function.__module__ = kernels.__name__  # Warp loads the function's module, which should be that of the kernels
        self.call = jax_callable(function, num_outputs=len(outputs), graph_mode=JaxCallableGraphMode.NONE)

    def __call__(self, *records, dims: list):
        """The outputs, of shapes `dims`."""
        arrays = []
        for kind, record in zip(self.inputs, records, strict=True):
            single = isinstance(kind, wp.array)
            arrays += [record] if single else [getattr(record, name) for name in kind.vars]
        # Warp numbers the traced calls and writes the number into the program. This would defeat JAX's compilation
        # cache. The number only tells static arguments apart, and there are none.
        self.call.call_id = 0
        with quiet():  # the module of the kernels is loaded here
            return self.call(*arrays, output_dims=dict(zip(self.outputs, dims, strict=True)))
