"""Scenarios: a title, settings that it is played with, and steps, each with what is seen after it.

    a stop stays until reset
      with rest 0.3; inrush 2     one line for each play; none: the usual settings
      stop                        -> stopped | answer stopped...
      run A                       -> declined arm-stopped
                                  -> a further line of what is seen after the last step

"..." stands for any text. Lines that begin with # are comments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest


@dataclass
class Line:
    number: int
    step: str
    seen: list[str]


@dataclass
class Scenario:
    title: str
    settings: list[str]
    lines: list[Line] = field(default_factory=list)


def read(path: Path) -> Iterator[Scenario]:
    """Yields each scenario of a file, once for each line of its settings."""
    scenario, settings = Scenario("", []), list[str]()
    for number, row in enumerate([*path.read_text().splitlines(), "the end"], 1):
        step, _, seen = map(str.strip, row.partition("->"))
        parts = [part.strip() for part in seen.split(" | ") if part.strip()]
        if row.startswith("#"):
            continue
        if row[:1].strip():  # a title
            for fields in (settings or [""]) if scenario.lines else []:
                yield Scenario(scenario.title, [part.strip() for part in fields.split(";") if part], scenario.lines)
            scenario, settings = Scenario(step, []), []
        elif step.startswith("with "):
            settings.append(step.removeprefix("with "))
        elif step:
            scenario.lines.append(Line(number, step, parts))
        elif parts:
            scenario.lines[-1].seen += parts


def cases(folder: Path) -> list[Any]:
    """Returns the scenarios of a folder's files as parameters (path, scenario) of a test."""
    return [
        pytest.param(path, scenario, id=f"{path.stem}: {scenario.title} {'; '.join(scenario.settings)}".rstrip())
        for path in sorted(folder.glob("*.txt"))
        for scenario in read(path)
    ]


def matches(found: str, told: str) -> bool:
    return re.fullmatch(re.escape(told).replace(r"\.\.\.", ".*"), found, re.DOTALL) is not None
