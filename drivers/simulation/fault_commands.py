"""Commands that cause faults of simulated boards; a person, a page or a test sends them.

A command is a verb, its target, and for some verbs a number, such as "silence can0/5" or "stick 5.left 1".
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from hyperbit.drivers.simulation.buses import SimulatedBuses


class Verb(NamedTuple):
    target: Literal["actuator", "board", "bus", "interlock"]
    argument: str  # name of its number; in brackets if it is optional, "" if there is none
    text: str  # one line for people


VERBS = {
    "silence": Verb("board", "", "disconnect the board from its bus"),
    "unsilence": Verb("board", "", "connect the board again"),
    "power_cut": Verb("board", "", "cut the supply of the board; springs return its actuators"),
    "power_on": Verb("board", "", "switch the supply on again"),
    "lose_tpdo": Verb("board", "", "lose the next TPDO of the board"),
    "error": Verb("board", "CODE", "the board reports an error by an emergency, such as 2320 (hexadecimal)"),
    "error_over": Verb("board", "CODE", "the error is over"),
    "stick": Verb("actuator", "STATE", "the actuator goes to an end, contracted or extended, and stays there"),
    "jam": Verb("actuator", "[POSITION]", "block the actuator where it is, or at a position from 0 to 1"),
    "release": Verb("actuator", "", "the actuator follows its valve again after stick or jam"),
    "slow": Verb("actuator", "FACTOR", "multiply its travel times; 1 is normal"),
    "lose_sensor": Verb("actuator", "", "freeze the readings of its end-stops"),
    "cut_wires": Verb("actuator", "", "its end-stops read 0"),
    "short_wires": Verb("actuator", "", "its end-stops read 1"),
    "restore_sensor": Verb("actuator", "", "its end-stops read correctly again"),
    "bus_off": Verb("bus", "", "the computer's CAN controller goes bus-off: no frame passes"),
    "bus_on": Verb("bus", "", "the CAN controller restarts"),
    "open": Verb("interlock", "", "open the interlock"),
    "close": Verb("interlock", "", "close the interlock"),
}
STATES = {"0": 0, "1": 1, "contracted": 0, "extended": 1}
MOST_NAMED = 24  # names in a message; of more, only the first and the last


def usage(verb: str) -> str:
    """Returns a verb with the names of its words, such as "stick ACTUATOR STATE"."""
    target, argument, _ = VERBS[verb]
    return " ".join(word for word in (verb, target.upper(), argument) if word)


def described() -> str:
    """Returns all verbs, a line each."""
    return "\n".join(f"  {usage(verb):28} {VERBS[verb].text}" for verb in VERBS)


def play(boards: SimulatedBuses, text: str) -> str:
    """Plays a command and returns the answer; "help": all verbs. Raises ValueError with the choices."""
    if text.split() == ["help"]:
        return "faults:\n" + "\n".join(f"  {usage(verb)} " for verb in VERBS)
    perform(boards, *text.split())
    return f"done: {' '.join(text.split())}"


def perform(boards: SimulatedBuses, *words: str | float) -> None:
    """Causes or ends a fault by the words of a command. Raises ValueError with the choices."""
    verb, name, arguments = str(words[0]) if words else "", str(words[1]) if len(words) > 1 else "", words[2:]
    if verb not in VERBS:
        raise ValueError(f"{verb!r} is no fault{nearest(verb, VERBS)} Faults: {', '.join(VERBS)}")
    target, wanted, _ = VERBS[verb]
    if not name or len(arguments) > bool(wanted) or len(arguments) < (bool(wanted) and not wanted.startswith("[")):
        raise ValueError(f"{' '.join(map(str, words))!r}: needed is {usage(verb)}: {VERBS[verb].text}")
    known = names(boards, target)
    if name not in known:
        choices = (
            f"{target.capitalize()}{'es' if target == 'bus' else 's'}: {named(known)}"
            if known
            else f"This arm has no {target}"
        )
        raise ValueError(f"{name!r} is no {target}{nearest(name, known)} {choices}")
    match target:
        case "board":
            _of_board(boards, verb, name, *arguments)
        case "bus":
            getattr(boards, verb)(name)
        case "interlock":
            getattr(boards, f"{verb}_interlock")(name)
        case "actuator":
            _of_actuator(boards, verb, name, *arguments)


def names(boards: SimulatedBuses, target: str) -> list[str]:
    known = {"board": boards.names, "bus": boards.buses, "actuator": boards.labels, "interlock": boards.interlocks}
    return known[target]


def _of_board(boards: SimulatedBuses, verb: str, name: str, *arguments: str | float) -> None:
    if arguments:
        getattr(boards, verb)(name, error_code(str(arguments[0])))
    else:
        getattr(boards, verb)(name)


def _of_actuator(boards: SimulatedBuses, verb: str, label: str, *arguments: str | float) -> None:
    numbers: list[float] = []
    match verb, arguments:
        case "stick", [state]:
            if str(state) not in STATES:
                raise ValueError(f"{state!r} is no state: contracted (0) or extended (1) is needed")
            numbers = [STATES[str(state)]]
        case "jam", [position]:
            numbers = [min(number(position), 1.0)]
        case "slow", [factor]:
            numbers = [positive(factor)]
    with boards.actuator(label) as it:
        getattr(it, verb)(*numbers)


def nearest(word: str, choices: Iterable[str]) -> str:
    """Returns ": did you mean ...?" with the nearest choice; "." if none is near."""
    found = difflib.get_close_matches(word, list(choices), 1)
    return f": did you mean {found[0]}?" if found else "."


def named(choices: list[str]) -> str:
    """Joins all choices, or the first and the last of many."""
    return ", ".join(choices) if len(choices) <= MOST_NAMED else f"{choices[0]} to {choices[-1]}"


def error_code(text: str) -> int:
    """Parses hexadecimal digits as an error code of CiA 301. Raises ValueError if they are none."""
    try:
        return int(text, 16) & 0xFFFF
    except ValueError:
        raise ValueError(f"{text!r} is no error code: four hexadecimal digits are needed, such as 2320") from None


def number(text: str | float) -> float:
    """Returns a finite number of at least 0. Raises ValueError if the text is no such number."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise ValueError(f"{text} is not a positive number")
    return value


def positive(text: str | float) -> float:
    """Returns a positive, finite number. Raises ValueError if the text is no such number."""
    if not (value := number(text)):
        raise ValueError(f"{text} is not a positive number")
    return value
