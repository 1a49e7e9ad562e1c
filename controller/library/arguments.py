"""Checks of all arguments of the public names: `typed` looks at each by its annotation.

A message has the argument's name, what would have been right and what was given. Shapes and bounds, which depend on the
arm, are checked where the arm is known.
"""

from __future__ import annotations

import inspect
import math
import os
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, wraps
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from hyperbit.controller.armfile.choices import LARGEST
from hyperbit.controller.library.errors import ConfigurationError, Error, GoalError, ObstacleError

Called = TypeVar("Called", bound=Callable[..., Any])

Number: TypeAlias = float | np.floating[Any] | np.integer[Any]
Numbers: TypeAlias = "ArrayLike | Sequence[Number] | Sequence[Sequence[Number]]"
Count: TypeAlias = int  # from 1
Seed: TypeAlias = int
Configurations: TypeAlias = "ArrayLike | str | Sequence[str]"

MOST, LAST_SEED = 10_000_000, 2**32 - 1


class Rule(NamedTuple):
    """What an argument must be."""

    needed: str  # with the verb of the sentence
    fits: Callable[[Any], bool]
    error: type[Error] | None = None  # None: that of the function


def is_a(*names: str) -> Callable[[Any], bool]:
    """Returns a test for objects of classes of hyperbit; their modules import this one."""
    return lambda given: any(
        kind.__name__ in names and kind.__module__.startswith("hyperbit.") for kind in type(given).__mro__
    )


def is_whole(given: Any, least: int, most: int) -> bool:
    """Returns whether a value is a whole number within bounds."""
    return isinstance(given, int | np.integer) and not isinstance(given, bool) and least <= int(given) <= most


def is_number(given: Any) -> bool:
    """Returns whether a value is a finite number."""
    try:
        real = isinstance(given, int | float | np.floating | np.integer) and not isinstance(given, bool)
        return real and math.isfinite(float(given))
    except OverflowError:
        return False


def array_of(given: Any) -> NDArray[Any]:
    """Returns a value as an array; a text if that is impossible."""
    try:
        array = np.asarray(given)
        array = array.astype(float) if array.dtype == object and array.ndim else array
        return np.array("masked") if np.ma.is_masked(given) else array
    except Exception:  # also those of an object's own conversion
        return np.array("no array")


def are_numbers(given: Any) -> bool:
    """Returns whether a value is an array of numbers of a usual size; greater ones overflow when they are squared."""
    array = array_of(given)
    return array.dtype.kind in "biuf" and bool((np.abs(array.astype(float)) <= LARGEST).all())


def is_configuration(given: Any) -> bool:
    """Returns whether a value may be a configuration, or many."""
    if isinstance(given, str):
        return True
    array = array_of(given)
    return array.dtype.kind in "iu" or (array.dtype.kind == "U" and array.ndim == 1)


def is_state(given: Any) -> bool:
    """Returns whether a value may be a configuration, or a solution that has one."""
    return is_a("Solution")(given) or is_configuration(given)


def is_motion(given: Any) -> bool:
    """Returns whether a value has configurations."""
    return is_a("Path")(given) or is_state(given) or is_list(given, is_state)


def is_text(given: Any) -> bool:
    """Returns whether a value is a text without lone surrogates."""
    return isinstance(given, str) and given.encode(errors="replace").decode() == given


def is_path(given: Any) -> bool:
    """Returns whether a value may be a path of a file."""
    try:
        return isinstance(given, str | os.PathLike) and b"\0" not in os.fsencode(given) and os.fspath(given) != ""
    except (TypeError, ValueError):
        return False


def is_list(given: Any, fits: Callable[[Any], bool] = lambda one: True) -> bool:
    """Returns whether a value is a list or an array, of elements that fit."""
    listed = isinstance(given, Sequence) and not isinstance(given, str | bytes | bytearray)
    return (listed or (hasattr(given, "__array__") and array_of(given).ndim > 0)) and all(map(fits, given))


def is_mapping(given: Any, fits: Callable[[Any], bool] = lambda one: True) -> bool:
    """Returns whether a value maps texts to values that fit."""
    return isinstance(given, Mapping) and all(map(is_text, given)) and all(map(fits, given.values()))


def is_goal(given: Any) -> bool:
    """Returns whether a value may be a goal."""
    return is_a("Goal")(given) or are_numbers(given)


GOALS = "a list of goals, each a Goal or the finite numbers of a position, is"
RULES: dict[str, Rule] = {
    "Arm": Rule("an arm, as from hb.load, is", is_a("Arm")),
    "Solver": Rule("a solver, hb.Solver(arm), is", is_a("Solver")),
    "Study | str | Path": Rule("a study, or the path of its file, is", lambda it: is_a("Study")(it) or is_path(it)),
    "bool": Rule("True or False is", lambda it: isinstance(it, bool | np.bool_)),
    "Count": Rule(f"a whole number from 1 to {MOST} is", partial(is_whole, least=1, most=MOST)),
    "int": Rule(f"a whole number from 0 to {MOST} is", partial(is_whole, least=0, most=MOST)),
    "Seed": Rule(f"a whole number from 0 to {LAST_SEED} is", partial(is_whole, least=0, most=LAST_SEED)),
    "Number": Rule("a finite number is", is_number),
    "Numbers": Rule(f"finite numbers up to {LARGEST:g} are", are_numbers),
    "Configurations": Rule("integers, base first, or a text are", is_configuration, ConfigurationError),
    "Start": Rule(
        "a configuration, a solution or a path is",
        lambda it: is_state(it) or (is_a("Path")(it) and len(it.solutions) > 0),
        ConfigurationError,
    ),
    "str": Rule("a text is", is_text),
    "Method": Rule("one of hb.METHODS is", is_text),
    "Diagonal": Rule('"BC" or "AD" is', is_text),
    "str | Path": Rule("the path of a file is", is_path),
    "Sequence[Module]": Rule(
        "a list of modules, such as [hb.vgt(...)] (hb.load reads an arm's file), is",
        lambda it: is_list(it, lambda one: isinstance(one, Struct)),
    ),
    "Sequence[Obstacle]": Rule("a list of obstacles, such as hb.Disc(...), is", is_list, ObstacleError),
    "Sequence[str]": Rule('a list of names, such as ["tip"], is', lambda it: is_list(it, is_text)),
    "Lengths": Rule("two numbers, or two for each leg, are", lambda it: are_numbers(it) or is_mapping(it, are_numbers)),
    "Mapping[str, str | None]": Rule(
        'states by label, such as {"1.left": "extended"}, are',
        lambda it: is_mapping(it, lambda one: one is None or is_text(one)),
    ),
    "GoalLike": Rule("a Goal, or the finite numbers of a position, is", is_goal, GoalError),
    "Goals": Rule(GOALS, lambda it: is_list(it, is_goal), GoalError),
    "Iterable[GoalLike] | NDArray[Any]": Rule(GOALS, lambda it: is_list(it) or isinstance(it, Iterable), GoalError),
    "Entries": Rule(
        "a list of goals, or of entries of a study's file, is",
        lambda it: is_list(it, lambda one: is_goal(one) or is_mapping(one)),
    ),
    "Callable[..., Arm]": Rule("a function is", callable),
    "Mapping[str, Mapping[str, Any]]": Rule("ranges by parameter are", lambda it: is_mapping(it, is_mapping)),
    "Client": Rule("a Client of Dask is", lambda it: hasattr(it, "scheduler_info")),
    "Axes": Rule("axes of matplotlib are", lambda it: hasattr(it, "get_figure")),
    "Motion": Rule("a path, solutions or configurations are", is_motion, ConfigurationError),
    "Drawn": Rule(
        "a path, solutions or configurations, or these by their names, are",
        lambda it: is_motion(it) or is_mapping(it, is_state),
        ConfigurationError,
    ),
}


def typed(error: type[Error]) -> Callable[[Called], Called]:
    """Returns a decorator that checks the arguments of a function, or of the constructor and methods of a class."""

    def decorate(called: Called) -> Called:
        if not inspect.isclass(called):
            return checked_call(called, error)
        for name, method in list(vars(called).items()):
            if inspect.isfunction(method) and (name == "__init__" or not name.startswith("_")):
                setattr(called, name, checked_call(method, error))
        return called

    return decorate


def checked_call(function: Called, error: type[Error]) -> Called:
    """Returns a function that checks its arguments before its work."""
    signature = inspect.signature(function)
    rules = dict[str, tuple[Rule, bool]]()
    for name, parameter in signature.parameters.items():
        if name != "self" and parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            kind = parameter.annotation.removesuffix(" | None")
            rules[name] = RULES[kind], kind != parameter.annotation or parameter.default is None

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        for name, given in signature.bind(*args, **kwargs).arguments.items():
            if name in rules:
                rule, optional = rules[name]
                if not (optional and given is None) and not rule.fits(given):
                    raise (rule.error or error)(f"{name}: {rule.needed} needed, got {told(given)}")
        return function(*args, **kwargs)

    return call  # type: ignore[return-value]


def plain(given: Any) -> Any:
    """Returns an array or a number of numpy as lists or numbers, and another object as text, which is a fault then."""
    return given.tolist() if isinstance(given, np.ndarray | np.generic) else told(given)


def told(given: Any) -> str:
    """Returns a value as a short text."""
    shown = reprlib.Repr()
    shown.maxother = shown.maxstring = 80
    try:
        return shown.repr(given)
    except ValueError:  # a whole number with more digits than Python prints
        return f"a {type(given).__name__} with very many digits"
