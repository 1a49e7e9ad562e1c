"""The refusals that the code makes, found in its syntax."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import NamedTuple

from hyperbit.controller.refusals.reasons import Reason

CONTROLLER = Path(__file__).parents[2] / "controller"


class Made(NamedTuple):
    where: str
    reason: Reason
    facts: frozenset[str]


def calls() -> list[tuple[str, ast.Call]]:
    texts = ((path, path.read_text()) for path in sorted(CONTROLLER.rglob("*.py")))
    return [
        (f"{path.relative_to(CONTROLLER)}:{node.lineno}", node)
        for path, text in texts
        if "Refusal(" in text or "Reason." in text  # to parse all files takes a second in each process of tests
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and makes_refusal(node)
    ]


def makes_refusal(call: ast.Call) -> bool:
    """Returns whether a call is that of `Refusal`, or of the `__init__` of a subclass with a reason by name."""
    match call:
        case ast.Call(func=ast.Name(id="Refusal")):
            return True
        case ast.Call(func=ast.Attribute(attr="__init__"), args=[ast.Attribute(value=ast.Name(id="Reason")), *_]):
            return True
    return False


def made() -> list[Made]:
    found = []
    for where, call in calls():
        match call.args[0]:
            case ast.Attribute(value=ast.Name(id="Reason"), attr=name):
                facts = frozenset(keyword.arg or "**" for keyword in call.keywords)
                found.append(Made(where, Reason[name], facts))
    return found
