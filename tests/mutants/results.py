"""Results as JSON lines, and their table."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.mutants.sites import Mutant

Record = dict[str, Any]
PHASES = ("simulation", "tests")


class Results:
    """Results of checks; the last one counts.

    Attributes:
        found: records by the mutant's id and phase.
        unchanged: seconds that the tests of a room take without a defect.

    Args:
        path: of the JSON lines; None: they are not stored.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.found: dict[tuple[str, str], Record] = {}
        self.unchanged: dict[str, float] = {}
        if path is not None and path.exists():
            for line in path.read_text().splitlines():
                with suppress(json.JSONDecodeError):  # a run was interrupted in this line
                    self._take(json.loads(line))

    def add(self, record: Record) -> None:
        self._take(record)
        if self._path is not None:
            text = self._path.read_bytes() if self._path.exists() else b""
            with self._path.open("a") as file:
                file.write("\n" * bool(text and not text.endswith(b"\n")) + json.dumps(record) + "\n")

    def _take(self, record: Record) -> None:
        if record["phase"] in PHASES:
            self.found[record["id"], record["phase"]] = record
        elif record["phase"] == "unchanged":
            self.unchanged[record["room"]] = record["seconds"]

    def found_by(self, mutant: Mutant) -> str:
        """Returns "simulation", "tests", "" for a survivor of all that ran, "open" if nothing ran."""
        records = [self.found.get((mutant.id, phase)) for phase in PHASES]
        for phase, record in zip(PHASES, records, strict=True):
            if record is not None and record["found"]:
                return phase
        return "" if any(records) else "open"

    def finders(self, module: str) -> list[str]:
        return [
            record["test"].split("::")[0]
            for (_, phase), record in self.found.items()
            if phase == "tests" and record["module"] == module and record.get("test")
        ]


def told(record: Record) -> str:
    if not record["found"]:
        return f"{record['phase']}: not found ({record['seconds']:.0f} s) {record['id']}"
    where = record.get("test") or (f"seed {record['seed']} {record['kind']}" if "seed" in record else "")
    return f"{record['phase']}: found ({record['seconds']:.0f} s) {record['id']}\n    {where}: {record['why'][:150]}"


def table(mutants: Iterable[tuple[str, Mutant]], results: Results) -> str:
    """Returns the counts of each room, then the survivors."""
    mutants = [(room, mutant, results.found_by(mutant)) for room, mutant in mutants]
    rooms = sorted({room for room, _, _ in mutants})
    lines = [f"{'room':30} {'mutants':>8} {'simulation':>11} {'tests':>6} {'survivors':>10} {'not run':>8}"]
    for name, chosen in [*((room, [room]) for room in rooms), ("all", rooms)]:
        by = [found for room, _, found in mutants if room in chosen]
        counts = [by.count(found) for found in ("simulation", "tests", "", "open")]
        lines.append(f"{name:30} {len(by):8} {counts[0]:11} {counts[1]:6} {counts[2]:10} {counts[3]:8}")
    survivors = [mutant for _, mutant, found in mutants if not found]
    for mutant in sorted(survivors, key=lambda mutant: (mutant.file, mutant.begin)):
        lines += ["", shown(mutant)]
    return "\n".join(lines)


def shown(mutant: Mutant) -> str:
    place = mutant.place
    return f"{mutant.id}\n{place['file']}:{place['line']}\n  - {place['before']}\n  + {place['after']}"


def equivalents(path: Path) -> dict[str, str]:
    """Reads the ids of mutants that behave like the program; the indented lines below an id are its reason."""
    found: dict[str, str] = {}
    name = ""
    for line in path.read_text().splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        if line.startswith(" "):
            found[name] = f"{found[name]} {line.strip()}".strip()
        else:
            name = line.strip()
            found[name] = ""
    without = [name for name, reason in found.items() if not reason]
    if without:
        raise ValueError(f"{path}: no reason below {without[0]}; write it in an indented line")
    return found
