"""An arm's file that has every field goes through every command that takes one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import pytest
from msgspec import Struct

from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.armfile.settings import ArmSettings
from tests.system.stack import daemon

FILE = Path(__file__).with_name("every_field.yaml")
JOINT = "x,y,th\n0.03,0.09,-0.3\n0.01,0.09,-0.1\n-0.01,0.09,0.1\n-0.03,0.09,0.3\n"
SPATIAL = {"sphere", "half_space", "BoxSettings>.orientation"}  # of arms in space


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("every")
    (folder / "tables").mkdir()
    (folder / "tables" / "joint.csv").write_text(JOINT)
    (folder / "every.yaml").write_text(FILE.read_text())
    return folder / "every.yaml"


def missing(value: Any, kind: Any, path: str = "") -> Iterator[str]:
    """Yields the fields of the reference that a document does not have anywhere."""
    kind = getattr(kind, "__origin__", kind) if hasattr(kind, "__metadata__") else kind
    values = value if isinstance(value, list) else [value]
    if get_origin(kind) in (list, dict):
        entries = [entry for each in values for entry in each.values()] if get_origin(kind) is dict else values
        yield from missing(entries, get_args(kind)[-1], path)
    elif get_origin(kind) in (Union, UnionType):
        for member in get_args(kind):
            if isinstance(member, type) and issubclass(member, Struct):
                tag = member.__struct_config__.tag
                own = [each for each in values if isinstance(each, dict) and tag in (None, each.get("type"))]
                yield from missing(own, member, f"{path}<{member.__name__}>")
    elif isinstance(kind, type) and issubclass(kind, Struct):
        for name, inner in get_type_hints(kind, include_extras=True).items():
            own = [each[name] for each in values if isinstance(each, dict) and name in each]
            if not own:
                yield f"{path}.{name}"
            else:
                flat = [entry for each in own for entry in (each if isinstance(each, list) else [each])]
                yield from missing(flat, inner, f"{path}.{name}")


def test_the_file_has_every_field_of_the_reference() -> None:
    every = missing(read_yaml(FILE), ArmSettings)
    # The same modules stand outside of groups; `wiring` names a table in place of `actuators`.
    found = [name for name in every if "<GroupSettings>.modules<" not in name and name != ".wiring"]
    assert not [name for name in found if not any(field in name for field in SPATIAL)], found


@pytest.fixture
def ran(hyperbit, tmp_path: Path, own_folders: None, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Runs a command, which must succeed; returns its output."""
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> str:
        code, out, err = hyperbit(*words)
        assert code == 0, f"{words}: {out}{err}"
        return out

    return run


def test_commands_without_a_daemon(ran: Callable[..., str], arm: Path, tmp_path: Path) -> None:
    file = str(arm)
    [warning] = json.loads(ran("check", file, "--json", "--picture", "arm.png"))["warnings"]
    assert "never commissioned" in warning
    goal = ",".join(str(x) for x in json.loads(ran("fk", file, "0,0,0,0,0,0,0,0,0", "--json"))["position"])
    assert json.loads(ran("plan", file, "--goal", goal, "--json", "--deadline", "2"))["within_tolerance"]
    ran("map", file)
    ran("workspace", file, "--at", goal, "--samples", "5")
    (tmp_path / "goals.csv").write_text(f"x,y\n{goal}\n")
    ran("plan", file, "--goals", "goals.csv", "--apart", "--effort", "20", "--output", "out.jsonl")
    copy = patient_copy(arm, tmp_path)
    assert (tmp_path / "tables" / "joint.csv").read_text() == JOINT
    assert json.loads(ran("check", str(copy), "--json"))["ok"]


def test_commands_of_a_running_arm(ran: Callable[..., str], arm: Path, tmp_path: Path) -> None:
    with daemon.running(arm, tmp_path) as endpoint:
        for words in (
            "fleet",
            "send every --configuration 010101000",
            "jog every 2.1=extended",
            "lock every 5.1=contracted",
            "lock every 5.1=free",
            "obstacles every",
            "poses every --save here",
            "fault every close door",
            "stop every",
            "reset every",
            "cancel every",
        ):
            ran(*words.split(), "--connect", endpoint)
