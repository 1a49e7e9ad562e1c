"""Facts of the code for the tables of the pages: names of fields, keys, faults, commands and others."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, get_args

import msgspec

from hyperbit.controller import cli
from hyperbit.controller.armfile import modules, settings
from hyperbit.controller.gateway import outbox, server
from hyperbit.controller.messages import reading
from hyperbit.controller.messages.goals import Answer, Plan, PlanPoint
from hyperbit.controller.motion.decoding import goal, requests, setpoint
from hyperbit.controller.motion.tracking import bias
from hyperbit.controller.panel.arms import arms
from hyperbit.controller.program.parts import Mode
from hyperbit.controller.refusals import codes
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.drivers.simulation.fault_commands import VERBS
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.documents.page import ROOT


def structs() -> Iterator[type[msgspec.Struct]]:
    for module in (settings, modules, goal, requests, setpoint, bias):
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, msgspec.Struct) and value.__module__ == module.__name__:
                yield value


def fields(struct: Any) -> set[str]:
    return set(struct.__struct_encode_fields__)


def sources(*folders: str) -> Iterator[str]:
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            yield path.read_text()


def keys() -> set[str]:
    """Returns the keys below hyperbit/<arm>/ that a daemon declares or publishes on."""
    declared = re.compile(r'(?:_query|_mailbox|declare_token)\(\s*f?"(?:{[a-z._]+}/)?(@?[a-z_]+)"')
    others = {key for text in sources("controller/gateway") for key in declared.findall(text)}
    return {*get_args(server.Command), *others, *outbox.PUBLISHED}


def listened() -> set[str]:
    """Returns the keys below PREFIX/<arm>/ on which any part of hyperbit hears or answers others."""
    return {*keys(), *arms.REPLAY_KEYS, "@claim", "answer"}


def faults() -> set[str]:
    from hyperbit.controller.panel.arms.faults import ADVICE

    return set(ADVICE)


def faults_of_the_code() -> set[str]:
    """Returns the fault codes that are literals in calls of `Fault`."""
    made = re.compile(r"Fault\(\s*\"([a-z-]+)\"")
    folders = ("controller/executor", "controller/planning", "controller/gateway", "drivers/canopen")
    return {code for text in sources(*folders) for code in made.findall(text)}


def exit_codes() -> set[str]:
    return set(re.findall(r"(\d+) [a-z]", str(cli.__doc__).partition("Exit codes: ")[2].partition("\n")[0]))


def result_codes() -> set[str]:
    return {str(value) for name, value in vars(codes).items() if name.isupper()}


def reasons() -> list[str]:
    """Returns the rows of the table of reasons: name with a code other than -1, sentence and advice."""
    named = ((it, f"`{it.value}`" + (f" {it.code}" if it.code != codes.INVALID_GOAL else "")) for it in Reason)
    cells = ((name, it.sentence, it.advice.replace("{arm}", "ARM")) for it, name in named)
    return [f"| {' | '.join(row)} |" for row in cells]


def rooms() -> set[str]:
    found = [path.parent for folder in ("controller", "drivers") for path in (ROOT / folder).glob("*/__init__.py")]
    return {f"{path.relative_to(ROOT).as_posix()}" for path in found}


def targets() -> set[str]:
    line = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert line
    return set(line[1].split())


def units() -> set[str]:
    return {path.name for path in (ROOT / "deploy").glob("*.service")}


def shipped_arms() -> set[str]:
    return {path.stem for path in (ROOT / "deploy").glob("*.yaml")}


TABLES: dict[str, Callable[[], set[str]]] = {
    "commands": lambda: set(cli.COMMANDS),
    "exit codes": exit_codes,
    "keys": keys,
    "listeners": listened,
    "faults": faults,
    "result codes": result_codes,
    "reasons": lambda: {reason.value for reason in Reason},
    "modes": lambda: set(get_args(Mode)),
    "methods": lambda: set(get_args(settings.Method)),
    "module types": lambda: {str(kind.__struct_config__.tag) for kind in get_args(modules.ModuleSettings)},
    "variants": lambda: set(VARIANTS),
    "faults on demand": lambda: set(VERBS),
    "rooms": rooms,
    "make targets": targets,
    "units": units,
    "arms": shipped_arms,
}
MESSAGES = {"answer": Answer, "plan": Plan, "point of a plan": PlanPoint, **reading.MESSAGES}
del MESSAGES["timeline"]  # of a replay
for key, message in MESSAGES.items():
    others = fields(Answer) if key == "plan" else set[str]()
    TABLES[f"payload of {key}"] = lambda message=message, others=others: fields(message) - others  # type: ignore[misc]
STRUCTS = {struct.__name__: struct for struct in structs()}
for struct in STRUCTS.values():
    TABLES[f"fields of {struct.__name__}"] = lambda struct=struct: fields(struct)  # type: ignore[misc]
