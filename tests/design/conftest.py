from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from hyperbit.controller.design.explore import explore
from hyperbit.controller.design.kept import kept
from hyperbit.controller.design.study import Study, read_study
from tests.commands.conftest import hyperbit, own_folders, told  # noqa: F401

SMALL: dict[str, Any] = {
    "name": "small",
    "seed": 1,
    "evaluations": 30,
    "finalists": {"most": 3, "targets": 12, "search": 20, "missed": 40},
    "parameters": {
        "modules": {"between": [2, 4]},
        "first": {"among": ["BC", "AD"]},
        "width": {"between": [0.1, 0.4]},
        "short": {"between": [0.15, 0.3]},
        "stroke": {"between": [0.02, 0.1], "step": 0.005},
    },
    "arm": {
        "tolerance": {"position": 0.05},
        "modules": [
            {
                "type": "vgt",
                "count": "$modules",
                "first_diagonal": "$first",
                "width": "$width",
                "lengths": ["$short", {"sum": ["$short", "$stroke"]}],
            }
        ],
    },
    "targets": [
        {"box": {"centre": [0, 0.8], "size": [0.8, 0.4]}, "count": 8},
        {"position": [0.1, 0.7], "weight": 2},
    ],
    "arms": ["other.yaml"],
}
OTHER = {
    "name": "other",
    "modules": [{"type": "vgt", "count": 3, "width": 0.2, "lengths": [0.2, 0.25]}],
    "tolerance": {"position": 0.05},
}

Written = Callable[..., Path]


@pytest.fixture
def written(tmp_path) -> Written:
    """Writes the small study with some fields changed, by paths such as "parameters.width"; None removes a field."""

    def write(changes: dict[str, Any] | None = None) -> Path:
        fields = copy.deepcopy(SMALL)
        for where, value in (changes or {}).items():
            *path, last = where.split(".")
            part = fields
            for key in path:
                part = part[key]
            part[last] = value
            if value is None:
                del part[last]
        (tmp_path / "other.yaml").write_text(yaml.safe_dump(OTHER))
        path = tmp_path / "study.yaml"
        path.write_text(yaml.safe_dump(fields, sort_keys=False))
        return path

    return write


@pytest.fixture
def study(written) -> Study:
    return read_study(written())


def run(study: Study, output: Path | None, count: int = 30, steps: int | None = None, client: Any = None) -> None:
    """Explores a study; `steps`: only so many steps, as if the process was killed then."""
    with kept(output, study, 5, count) as found:
        progress = explore(study, count, 5, found, client)
        for number, _ in enumerate(progress, 1):
            if number == steps:
                progress.close()
                return
