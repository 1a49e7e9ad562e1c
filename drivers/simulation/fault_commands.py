"""Faults of simulated boards by words: lines that a person types, or a test."""

from __future__ import annotations

from drivers.simulation.buses import SimulatedBuses

HELP = """\
Faults on demand, a line each: stick 5.left 1 | release 5.left | slow 5.left 4 | lose_sensor 5.left |
restore_sensor 5.left | silence can0/5 | unsilence can0/5 | power_cut can0/5 | power_on can0/5"""

_VERBS = (
    *("release", "lose_sensor", "restore_sensor"),
    *("silence", "unsilence", "power_cut", "power_on"),
)


def perform(boards: SimulatedBuses, *words: str | float) -> None:
    """Causes a fault, or ends one: a verb, the name of an actuator or board, and for two verbs a number; see `HELP`.

    Raises:
        ValueError: the words make no fault; the sentence says why.
    """
    match words:
        case ["stick", str(label), ("0" | "1" | 0 | 1) as state]:
            boards.stick(label, int(state))
        case ["slow", str(label), factor]:
            boards.slow(label, positive(factor))
        case [str(verb), str(name)] if verb in _VERBS:
            getattr(boards, verb)(name)
        case _:
            raise ValueError(f"{' '.join(map(str, words))!r} is no fault. {HELP}")


def positive(number: str | float) -> float:
    """A positive, finite number.

    Raises:
        ValueError: it is not.
    """
    value = float(number)
    if not 0.0 < value < float("inf"):
        raise ValueError(f"{number} is not a positive number")
    return value
