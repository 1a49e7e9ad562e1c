"""The questions of the command `new`: each answer comes from an option, from the user, or is the default."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, get_args

from hyperbit.controller.armfile.choices import SECONDS, number
from hyperbit.controller.armfile.fields import NAME
from hyperbit.controller.armfile.module_texts import KINDS, Number, default_text, known, parse_module, whole
from hyperbit.controller.armfile.new_file import VALVES, Answers, EndStops, ErrorStates, Valves, Wiring, new_file
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.units import Unit, factors, value_in
from hyperbit.controller.commands import common
from hyperbit.controller.commands.common import CommandFailed

Reader = Callable[[str], Any]


class Question(NamedTuple):
    """A question for one answer; the option of the same name gives it, too."""

    words: str
    read: Reader  # returns the answer of a text; raises ValueError
    asked: Callable[[Mapping[str, Any]], bool] = lambda answers: True  # whether the answers so far make it matter


def one_of(kind: Any) -> Reader:
    return lambda text: known(text.strip(), [str(value) for value in get_args(kind)], "answer")


def count(most: int) -> Reader:
    return lambda text: whole(text, 1, most)


def time(least: float, most: float) -> Reader:
    def read(text: str) -> float:
        value = value_in(text, factors(None)[SECONDS])
        if value is None:
            return number(text, most, least)
        if not least <= value <= most:
            raise ValueError(f"{least:g} s to {most:g} s are needed, got {text!r}")
        return value

    return read


def name(text: str) -> str:
    if not 1 <= len(text) <= 64 or not text.replace("_", "a").replace("-", "a").isalnum() or not text.isascii():
        raise ValueError(f"{NAME} are needed, got {text!r}")
    return text


def bit_rate(text: str) -> int:
    value = value_in(text, factors(None)["in bit/s"])
    return round(number(text, 1e6, 1e4) if value is None else number(f"{value:.0f}", 1e6, 1e4))


def yes(text: str) -> bool:
    return bool(known(text.strip().lower(), {"yes": True, "no": False, "true": True, "false": False}, "yes or no"))


QUESTIONS: Mapping[str, Question] = {
    "name": Question("Name of the arm", name),
    "unit": Question("Unit of all lengths: m, cm, mm or in", one_of(Unit)),
    "modules": Question("", lambda text: text),
    "repeat": Question("Repetitions of these modules", count(10_000)),
    "tolerance": Question("Greatest distance of the tip from a goal", lambda text: number(text, 1e6, 1e-9)),
    "travel_time": Question("Longest time of an actuator from end to end, such as 100 ms", time(1e-3, 60)),
    "valves": Question(
        f"Outputs of an actuator: {'; '.join(f'{k}: {it}' for k, it in VALVES.items())}", one_of(Valves)
    ),
    "pulse": Question("Length of a pulse, such as 50 ms", time(0.01, 10), lambda given: given["valves"] == "pulse"),
    "end_stops": Question("End-stops of an actuator: none, extended (that end) or both", one_of(EndStops)),
    "bus": Question("CAN interface", name),
    "bitrate": Question("Bit rate of the bus, such as 500 kbit/s", bit_rate),
    "island": Question("Are the boards valve islands, yes or no", yes),
    "outputs": Question("Outputs of a board; of a valve island two for each valve", count(2032)),
    "boards": Question("Number of boards", count(126)),
    "first_node": Question("Node id of the first board; the others follow", count(126)),
    "error_state": Question(
        "Outputs without the master, on boards that lack 6206h and 6207h: off, hold, device; none: all have both",
        one_of(ErrorStates),
    ),
    "wiring": Question("Wiring as rows of the file, or as a csv beside it: rows or csv", one_of(Wiring)),
}


def collected(given: Mapping[str, str], modules: list[str], file: Path, asks: bool) -> Answers:
    """Returns the answers: those of options, then, if it `asks`, those of the user, and defaults for the others."""
    found: dict[str, Any] = dict(Answers(file.stem, ())._asdict())
    for field, question in QUESTIONS.items():
        if field == "modules":
            found[field] = tuple(option_modules(modules, found["unit"]) if modules else asked_modules(found["unit"]))
            continue
        read = fitting(field, question.read, found) if field in ("outputs", "boards", "first_node") else question.read
        if field in given:
            found[field] = option(f"--{field.replace('_', '-')}", given[field], read)
        elif asks and question.asked(found):
            found[field] = ask(question.words, read, default_of(field, found))
    return Answers(**found)


def fitting(field: str, read: Reader, found: Mapping[str, Any]) -> Reader:
    """Returns the reader of an answer with which the actuators find room; the other answers are `found`."""

    def read_fitting(text: str) -> Any:
        value = read(text)
        new_file(Answers(**{**found, field: value}), Path("new.yaml"), "")
        return value

    return read_fitting


def default_of(field: str, found: Mapping[str, Any]) -> str:
    """Returns the text of the default of a question."""
    value = found[field]
    if field == "tolerance":
        return default_text(Number("", default="2"), found["unit"])
    if field == "boards":
        return str(new_file(Answers(**found), Path("new.yaml"), "").boards)
    if field in ("travel_time", "pulse"):
        return f"{value * 1e3:g} ms"
    return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)


def option(words: str, text: str, read: Reader) -> Any:
    try:
        return read(text)
    except ValueError as error:
        raise InputFaults(Path(words), [str(error)]) from None


def option_modules(texts: list[str], unit: str) -> Iterator[str]:
    for text in texts:
        option("--module", text, lambda it: parse_module(it, unit))
        yield text


def asked_modules(unit: str) -> Iterator[str]:
    """Yields the texts of modules that the user describes, base first, until an empty answer."""
    common.errors.print("Modules, base first. Kinds: " + "; ".join(f"{it}: {kind.words}" for it, kind in KINDS.items()))
    number_of = 1
    while True:
        default = "no more" if number_of > 1 else "prismatic"
        kind = ask(f"Module {number_of}", lambda text: text if text == "no more" else module_kind(text, unit), default)
        if kind == "no more":
            return
        text = kind
        if kind in KINDS:
            for field, own in KINDS[kind].numbers.items():
                words = f"  {own.ask} [{'degrees' if own.angle else unit}]"
                value = ask(words, field_reader(kind, field, unit), default_text(own, unit))
                text += f" {field}={value}"
        yield text
        number_of += 1


def module_kind(text: str, unit: str) -> str:
    parse_module(text, unit)
    return text.strip()


def field_reader(kind: str, field: str, unit: str) -> Reader:
    def read(text: str) -> str:
        joined = "".join(text.split())
        parse_module(f"{kind} {field}={joined}", unit)
        return joined

    return read


def ask(words: str, read: Reader, default: str) -> Any:
    """Asks until an answer can be read; an empty one is the default."""
    while True:
        common.errors.print(f"{words} ({default}): ", end="")
        line = sys.stdin.readline()
        if not line:
            raise CommandFailed("the answers end here; nothing is written")
        try:
            return read(line.strip() or default)
        except ValueError as error:
            common.errors.print(f"  {error}")
