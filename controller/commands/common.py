"""Readers and printers that the commands share.

Commands that only talk to a daemon import this module, too. It therefore imports kernels and NumPy inside functions.

CommandFailed and InputFaults end a command with their message and an exit code. Docstrings of commands name only other
exceptions.
"""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta, Struct

from hyperbit.controller.armfile.documents import read_yaml
from hyperbit.controller.armfile.strict import InputFaults, check
from hyperbit.controller.refusals.reasons import advice

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hyperbit.controller.arm.arm import Arm
    from hyperbit.controller.manipulator.manipulator import Configuration
    from hyperbit.controller.workspace.densities import Densities

    console: Console
    errors: Console


def __getattr__(name: str) -> Console:
    """Returns `console` or `errors`, created at the first use: a request must not wait for the import of rich."""
    if name not in ("console", "errors"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from rich.console import Console

    globals()[name] = created = Console(stderr=name == "errors", markup=False, highlight=False, soft_wrap=True)
    return created


class CommandFailed(Exception):
    """A request failed; the command exits with code 1. `step`: next step for the user."""

    def __init__(self, message: str, step: str = "") -> None:
        super().__init__(f"{message}\nNext: {step}" if step else message)


class Named(Struct, frozen=True):
    """The field of an arm's file that clients of its daemon need."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,64}\Z", description="1 to 64 letters, digits, _ and -")]


def refusal(answer: Mapping[str, Any], arm: str) -> CommandFailed:
    """Returns the error for a refusing answer or a failed result of an arm's daemon.

    `arm`: how a further command line names the arm, see connection.named.
    """
    status, message, code = answer.get("status", "refused"), answer.get("message", ""), answer.get("code", "unknown")
    step, given = advice(answer.get("reason"), arm), shlex.split(arm)[0]
    if given.endswith((".yaml", ".yml")):
        step = step.replace("ARM.yaml", shlex.quote(given))
    return CommandFailed(f"{status} (code {code}): {message}", step)


def print_json(value: object) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


def check_output(path: Path) -> None:
    """Refuses a file of results that cannot be written, before the work begins."""
    there = path.exists()
    try:
        path.open("ab").close()
    except OSError as error:
        raise InputFaults(path, [f"cannot be written: {error.strerror}"]) from None
    if not there:
        path.unlink()


def check_picture(path: Path) -> None:
    """Refuses a picture that cannot be drawn or written, before the work begins."""
    if find_spec("matplotlib") is None:
        raise CommandFailed("pictures need matplotlib", "pip install 'hyperbit[pictures]'")
    check_output(path)


@contextlib.contextmanager
def drawing(picture: Path) -> Iterator[None]:
    """Refuses a picture that cannot be drawn or written, or whose suffix names no format."""
    check_picture(picture)
    try:
        yield
    except (OSError, ValueError) as error:
        raise InputFaults(picture, [f"cannot be written: {error}"]) from None


def shipped(name: str) -> Path:
    """Returns the path of a file in deploy/."""
    return Path(__file__).parents[2] / "deploy" / name


def densities_of(arm: Arm, *, rebuild: bool = False, silent: bool = False) -> Densities:
    """Reads an arm's densities from the cache, or computes them with a progress bar on stderr."""
    from rich.progress import Progress

    from hyperbit.controller.commands import common
    from hyperbit.controller.workspace.cache import default_directory, key, load_or_map

    directory = default_directory()
    if rebuild:
        wanted = key(arm.reduced, arm.pixel, arm.level_pixels)
        (directory / f"{wanted[:24]}.npz").unlink(missing_ok=True)
    with Progress(console=common.errors, transient=True, disable=silent or not common.errors.is_terminal) as progress:
        task = progress.add_task("mapping the intermediate workspaces", total=len(arm.manipulator.modules) + 1)
        return load_or_map(
            arm.reduced,
            arm.pixel,
            arm.level_pixels,
            directory,
            lambda done: progress.update(task, completed=done),
        )


def load_wired(path: Path) -> Arm:
    """Returns the arm of a file, which must map actuators to boards."""
    from hyperbit.controller.arm.arm import load

    arm = load(path)
    if not arm.wiring:
        raise InputFaults(path, ["actuators: none is mapped to a board, so there is nothing to run"])
    return arm


def arm_name(arm: str) -> str:
    """Returns the name of an arm, given by its file or name. It reads only the name: an arm imports the kernels."""
    path = Path(arm)
    faults = list[str]()
    if not path.is_file() and not arm.endswith((".yaml", ".yml")):
        if check({"name": arm}, Named, faults) is None:
            raise InputFaults(Path(repr(arm)), ["no name of an arm: 1 to 64 letters, digits, _ and - are needed"])
        return arm
    raw = read_yaml(path)
    value = {"name": raw["name"]} if isinstance(raw, dict) and "name" in raw else {}
    if (named := check(value, Named, faults)) is None:
        raise InputFaults(path, faults)
    return named.name


def configuration(arm: Arm, text: str, where: str) -> Configuration:
    """Parses a configuration, shape (B,); messages begin with `where`."""
    from hyperbit.controller.manipulator.notation import parse_configuration

    try:
        return parse_configuration(arm.manipulator, text)
    except ValueError as error:
        raise InputFaults(Path(where), [str(error)]) from None


def drawn(text: str, plain: str) -> str:
    """Returns a text if the terminal can show it, otherwise a plain one."""
    from hyperbit.controller.commands.common import console

    try:
        text.encode(console.encoding)
    except UnicodeEncodeError:
        return plain
    return text


def counted(switches: int) -> str:
    return f"{switches} {'switch' if switches == 1 else 'switches'}"


def shown(values: Any) -> str:
    """Returns numbers with four decimals, separated by commas."""
    import numpy as np

    return ", ".join(f"{v:.4f}" for v in np.atleast_1d(values))


def results_table(*columns: str) -> Table:
    """Returns an empty table whose cells do not wrap on a narrow terminal."""
    from rich.table import Table

    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold underline")
    for column in columns:
        table.add_column(column, no_wrap=True)
    return table


def print_table(table: Table) -> None:
    """Prints a table with all of its columns: a narrow terminal wraps the lines, and shortens no cell."""
    from rich.measure import Measurement

    from hyperbit.controller.commands.common import console

    table.width = Measurement.get(console, console.options.update(width=1000), table).maximum
    console.print(table)
