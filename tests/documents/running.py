"""Runs the examples of a page in a separate folder with links to the project's folders."""

from __future__ import annotations

import contextlib
import copy
import functools
import importlib
import io
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import typer
import yaml

from hyperbit.controller import cli
from hyperbit.controller.arm.arm import load
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.connection import connected
from tests.arm_files import document
from tests.documents.page import ROOT, Example, Page

PATIENCE = 300.0  # [s] for a shell block, on a machine that stands still at times
SHARED = ("controller", "deploy", "drivers", "tests")  # folders that examples name
Daemon = Callable[[Path], str]  # starts one of an arm's file if there is none; returns its endpoint


def prepare(folder: Path, hyperbit: str) -> None:
    """Puts links to the project's folders, and the script `hyperbit`, into the folder of a page.

    The other script of this name adds the endpoint of the daemon.
    """
    for name in SHARED:
        (folder / name).symlink_to(ROOT / name)
    connecting = "|".join(name for name in cli.COMMANDS if "--connect" in options(name))
    add = f'#!/bin/sh\ncase $1 in {connecting}) set -- "$@" ${{DAEMON:+--connect $DAEMON}};; esac\n'
    for name, script in (("forked", hyperbit), ("hyperbit", f'{add}exec forked "$@"\n')):
        file = folder / "bin" / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(script)
        file.chmod(0o755)


def run(page: Page, folder: Path, daemon: Daemon) -> None:
    variables: dict[str, Any] = {"__name__": "__main__"}
    printed = ""
    for example in page.examples:
        where = f"{page.name}:{example.line}"
        if "not run" in example.marks:
            continue
        file = example.marks.get("with", "").removeprefix("daemon").removeprefix(" of ")
        arm = folder / file if file else ROOT / "deploy" / "planar16.yaml"
        endpoint = daemon(arm) if {"with", "request"} & example.marks.keys() else None
        match example.language:
            case "sh":
                printed = run_shell(example.text, folder, endpoint, where)
            case "python":
                printed = run_python(example.text, variables, endpoint, where)
            case "yaml":
                read_fields(example.text, folder / "fields.yaml", where)
            case "json":
                send(example, endpoint, where)
            case _ if "prints" in example.marks:
                compare(example.text, printed, where)


def run_shell(text: str, folder: Path, endpoint: str | None, where: str) -> str:
    """Runs a shell block, which must succeed; returns its output."""
    path = f"{folder / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "COLUMNS": "200", "PYTHONPATH": str(ROOT)}
    if endpoint is not None:
        environment["DAEMON"] = endpoint
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", text],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, f"{where} ends with {done.returncode}:\n{done.stdout}"
    return done.stdout


def run_python(text: str, variables: dict[str, Any], endpoint: str | None, where: str) -> str:
    """Runs a Python block in the current folder, which is the page's; returns its output."""
    printed = io.StringIO()
    text = text.replace(ENDPOINT, endpoint or ENDPOINT)
    with contextlib.redirect_stdout(printed):
        exec(compile(text, where, "exec"), variables)
    return printed.getvalue()


def read_fields(text: str, file: Path, where: str) -> None:
    """Reads an arm's file that consists of a YAML block and the fields of a short arm, wired if it fits."""
    given = yaml.safe_load(text)
    assert isinstance(given, dict), f"{where}: no fields of an arm's file"
    whole = {name: copy.deepcopy(document()[name]) for name in ("name", "modules", "tolerance", "buses", "actuators")}
    if "modules" in given:
        whole = {
            name: whole[name] for name in ("name", "tolerance", "buses") if name != "buses" or "actuators" in given
        }
    wired = {(entry["module"], entry["actuator"]): entry for entry in whole.get("actuators", [])}
    wired |= {(entry["module"], entry["actuator"]): entry for entry in given.pop("actuators", [])}
    buses = {bus["name"]: bus for bus in [*whole.pop("buses", []), *given.pop("buses", [])]}
    whole |= {"actuators": list(wired.values()), "buses": list(buses.values())}
    file.write_text(yaml.safe_dump({**whole, **given}))
    load(file)


def send(example: Example, endpoint: str | None, where: str) -> None:
    """Decodes a JSON block, and sends it if it is marked as a request."""
    payload = json.loads(example.text)
    if endpoint is not None:
        with connected("planar16", endpoint, None) as client:
            answer = client.request(example.marks["request"], payload, timeout=60.0)
        assert answer.get("accepted", True), f"{where}: {answer}"


def compare(expected: str, printed: str, where: str) -> None:
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    for line in filter(None, (" ".join(line.split()) for line in expected.splitlines())):
        form = re.compile(".*".join(map(re.escape, line.split("..."))))
        assert any(form.fullmatch(one) for one in lines), f"{where}: {line!r} is not printed:\n{printed}"


@functools.cache
def options(command: str) -> Mapping[str, bool]:
    """Returns the options of a command, each with whether it takes a value."""
    entry = cli.COMMANDS[command]
    module = importlib.import_module(f"hyperbit.controller.commands.{entry.module}")
    single = typer.Typer(add_completion=False)
    single.command()(getattr(module, command.replace("-", "_")))
    parameters = typer.main.get_command(single).params
    return {name: not getattr(p, "is_flag", False) for p in parameters for name in (*p.opts, *p.secondary_opts)} | {
        "--help": False
    }
