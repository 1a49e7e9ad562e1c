"""Pickles of events: how to write them, and whose methods they may contain.

A pickle could call any function. So a reader accepts only data, and classes without side effects.
"""

from __future__ import annotations

import copyreg
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
LEFT_OUT = "left out"  # replaces an opaque value that is not None


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


def method_of(owner: object, name: str) -> MethodType:
    """Returns a method of an object of a pure module; pickles of bound methods call this."""
    function = next((vars(kind)[name] for kind in type(owner).__mro__ if name in vars(kind)), None)
    if not isinstance(function, FunctionType) or not PURE.fullmatch(function.__module__):
        raise RefusedFile(f"the file contains a method {name!r} of {type(owner).__name__}: it is not loaded")
    return MethodType(function, owner)


def stands_outside(name: str) -> Any:
    """Replaces, in a pickle, an object that is recorded by name. `load` gets the object itself."""
    raise RefusedFile(f"{name!r} was not given")
