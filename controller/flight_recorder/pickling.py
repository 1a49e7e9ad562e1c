"""Pickles of events: how to write them, and which ones to read.

A pickle could call any function. So only data, and classes without side effects, are accepted.
"""

from __future__ import annotations

import copyreg
import importlib
import io
import pickle
import re
from collections.abc import Callable, Mapping
from types import FunctionType, MappingProxyType, MethodType
from typing import Any

from hyperbit.controller.host.keeper import RefusedFile

# What a pickle of events may contain: classes of these modules, which only hold data and compute.
PURE = re.compile(
    r"hyperbit\.controller\.(armfile\.settings|host\.process|program(\.\w+)?"
    r"|(manipulator|motion(\.\w+)?|obstacles|planning\.core|refusals)\.\w+)"
    r"|hyperbit\.controller\.executor\.(arm|core|motion)\.\w+"
    r"|hyperbit\.drivers\.canopen\.((boards|boot|run|sdo)\.\w+|faults|layout|pdo|status|wiring|wire\.(cia301|events|link))"
)
CORE = "hyperbit.controller.planning.core."  # its functions are pure, too
LEFT_OUT = "left out"  # replaces an opaque value that is not None
OTHERS = {
    ("hyperbit.controller.flight_recorder.pickling", "method_of"),
    ("collections", "Counter"),
    ("collections", "OrderedDict"),
    ("collections", "defaultdict"),
    ("collections", "deque"),
    ("functools", "partial"),
    ("filterpy.kalman.kalman_filter", "KalmanFilter"),
    ("numpy.linalg", "inv"),  # attribute of the filter
    *(
        ("builtins", name)
        for name in ("bytearray", "complex", "dict", "frozenset", "int", "list", "range", "set", "slice")
    ),
    *(("numpy", name) for name in ("dtype", "ndarray")),
    *((f"numpy.{core}.multiarray", name) for core in ("core", "_core") for name in ("_reconstruct", "scalar")),
    *((f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")),
}


def reducers(opaque: Mapping[type, str], outside: Mapping[str, object]) -> dict[type, Callable[[Any], Any]]:
    """Returns a Pickler's reducers for objects that pickle refuses, or would look up by `getattr`."""
    names = {id(it): name for name, it in outside.items()}

    def without(field: str) -> Callable[[Any], Any]:
        def reduced(it: Any) -> Any:
            stands = None if getattr(it, field) is None else LEFT_OUT
            if isinstance(it, tuple):  # a NamedTuple
                return type(it), tuple(it._replace(**{field: stands}))  # type: ignore[attr-defined]
            return copyreg.__newobj__, (type(it),), vars(it) | {field: stands}  # type: ignore[attr-defined]

        return reduced

    def by_name(it: object) -> Any:
        if id(it) not in names:
            raise pickle.PicklingError(f"it has another {type(it).__name__} than {', '.join(outside)}")
        return stands_outside, (names[id(it)],)

    table: dict[type, Callable[[Any], Any]] = dict(copyreg.dispatch_table)
    table[MethodType] = lambda method: (method_of, (method.__self__, method.__name__))
    table[MappingProxyType] = lambda mapping: (dict, (dict(mapping),))
    table |= {type(it): by_name for it in outside.values()}
    return table | {kind: without(field) for kind, field in opaque.items()}


class _Unpickler(pickle.Unpickler):
    def __init__(self, content: bytes, given: Mapping[str, Any]) -> None:
        super().__init__(io.BytesIO(content))
        self._given = given

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == (__name__, stands_outside.__name__):
            return self._outside
        if (module, name) in OTHERS:
            return getattr(importlib.import_module(module), name)
        if PURE.fullmatch(module):
            found = getattr(importlib.import_module(module), name, None)
            pure = isinstance(found, type) or (isinstance(found, FunctionType) and module.startswith(CORE))
            if pure and found.__module__ == module:
                return found
        raise RefusedFile(f"the file contains {module}.{name}, which no file of events may contain: it is not loaded")

    def _outside(self, name: str) -> Any:
        if name not in self._given:
            raise RefusedFile(
                f"the core needs {name!r}, which is not in the file: it can only be made from the arm's file"
            )
        return self._given[name]


def unpickle(content: bytes, given: Mapping[str, Any] = MappingProxyType({})) -> Any:
    """Unpickles data without code; `given`: objects recorded by name. Raises RefusedFile for any other pickle."""
    try:
        return _Unpickler(content, given).load()
    except RefusedFile:
        raise
    except Exception as error:
        raise RefusedFile(f"a pickle cannot be read: {type(error).__name__}: {error}") from None


def method_of(owner: object, name: str) -> MethodType:
    """Returns a method of an object of a pure module; pickles of bound methods call this."""
    function = next((vars(kind)[name] for kind in type(owner).__mro__ if name in vars(kind)), None)
    if not isinstance(function, FunctionType) or not PURE.fullmatch(function.__module__):
        raise RefusedFile(f"the file contains a method {name!r} of {type(owner).__name__}: it is not loaded")
    return MethodType(function, owner)


def stands_outside(name: str) -> Any:
    """Replaces, in a pickle, an object that is recorded by name. `load` gets the object itself."""
    raise RefusedFile(f"{name!r} was not given")
