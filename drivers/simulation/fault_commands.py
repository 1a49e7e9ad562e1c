"""Commands that cause faults of simulated boards, typed by a person or sent by a test."""

from __future__ import annotations

from drivers.simulation.buses import SimulatedBuses

HELP = """\
Faults on demand, a line each: stick 5.left 1 | jam 5.left | jam 5.left 0.5 | release 5.left | slow 5.left 4 |
lose_sensor 5.left | cut_wires 5.left | short_wires 5.left | restore_sensor 5.left | silence can0/5 | unsilence can0/5 |
lose_tpdo can0/5 | power_cut can0/5 | power_on can0/5 | error can0/5 2320 | error_over can0/5 2320 |
open door | close door"""

_ACTUATOR = ("jam", "release", "lose_sensor", "cut_wires", "short_wires", "restore_sensor")
_OTHERS = ("silence", "unsilence", "lose_tpdo", "power_cut", "power_on")


def perform(boards: SimulatedBuses, *words: str | float) -> None:
    """Causes or ends a fault. The words are a verb, a name, and for some verbs a number; see `HELP`.

    Raises:
        ValueError: the words are no fault command; the text says why.
        KeyError: there is no board, actuator or interlock of this name.
    """
    match words:
        case ["stick", str(label), ("0" | "1" | 0 | 1) as state]:
            with boards.actuator(label) as it:
                it.stick(int(state))
        case ["jam", str(label), text]:
            position = min(number(text), 1.0)
            with boards.actuator(label) as it:
                it.jam(position)
        case ["slow", str(label), text]:
            factor = positive(text)
            with boards.actuator(label) as it:
                it.slow(factor)
        case [str(verb), str(label)] if verb in _ACTUATOR:
            with boards.actuator(label) as it:
                getattr(it, verb)()
        case ["error" | "error_over" as verb, str(name), str(code)]:
            getattr(boards, verb)(name, int(code, 16) & 0xFFFF)
        case ["open" | "close" as verb, str(name)]:
            getattr(boards, f"{verb}_interlock")(name)
        case [str(verb), str(name)] if verb in _OTHERS:
            getattr(boards, verb)(name)
        case _:
            raise ValueError(f"{' '.join(map(str, words))!r} is no fault. {HELP}")


def number(text: str | float) -> float:
    """Returns a finite number of at least 0.

    Raises:
        ValueError: the text is no such number.
    """
    value = float(text)
    if not 0.0 <= value < float("inf"):
        raise ValueError(f"{text} is not a positive number")
    return value


def positive(text: str | float) -> float:
    """Returns a positive, finite number.

    Raises:
        ValueError: the text is no such number.
    """
    if not (value := number(text)):
        raise ValueError(f"{text} is not a positive number")
    return value
