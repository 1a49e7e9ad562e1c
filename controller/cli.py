"""The `hyperbit` command. Exit codes: 0 done, 1 failed, 2 unusable input, 129 hang-up, 130 interrupted, 143 terminated.

A command's module is imported when the command runs: `hyperbit stop` must not wait for the kernels of the search.
"""

import errno
import importlib
import io
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from hyperbit.controller.commands.table import COMMANDS, GROUPS, CommandEntry
from hyperbit.controller.host.machine_code import ADVICE, REFUSAL
from hyperbit.controller.host.signals import exit_on_signals

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.ENOMEM)  # of disk and system
UNUSABLE = (errno.EROFS, errno.ENOLCK, errno.EACCES)  # of the place of a file; the error has the remedy
WIDE = {"max_content_width": 120}  # columns of --help, on terminals that have them


class PlainValue:
    """Converts texts and paths, by their `kind`, without Typer, and other values with Typer's `usual` converter.

    Typer imports pydantic for the conversion. This import takes longer than the rest of `hyperbit stop`.
    """

    def __init__(self, kind: object, usual: Callable[[], Any]) -> None:
        self._kind, self._usual = kind, usual

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Returns the converted value of a parameter; the interface is that of Typer's RuntimeParam."""
        if param.nargs == 1 and not param.multiple:
            if value is None:
                return None
            if self._kind in (str, Path):
                return self._kind(value)
        return self._usual().coerce(value, param=param, ctx=ctx)


class QuickCommand(TyperCommand):
    """A command whose texts and paths are converted without Typer; see PlainValue."""

    def get_params(self, ctx: Any) -> list[Any]:
        return [quick(parameter) for parameter in super().get_params(ctx)]


def quick(parameter: Any) -> Any:
    """Makes PlainValue the converter of a parameter; returns the parameter."""
    if "get_runtime_param" not in vars(parameter):
        converter = PlainValue(parameter.type_descriptor.annotation, parameter.get_runtime_param)
        parameter.get_runtime_param = lambda: converter
    return parameter


class DeferredCommand(TyperCommand):
    """A command whose module is imported when its arguments are parsed."""

    def __init__(self, name: str, entry: CommandEntry) -> None:
        super().__init__(name, help=entry.summary)
        self._entry = entry

    def get_short_help_str(self, limit: int = 0) -> str:
        """Returns the whole summary: the list of commands wraps it."""
        return self._entry.summary

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Imports the command and returns its context; the group then invokes that command in place of this one."""
        module = importlib.import_module(f"hyperbit.controller.commands.{self._entry.module}")
        single = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        function, epilog = getattr(module, (self.name or "").replace("-", "_")), f"Example: {self._entry.example}"
        single.command(self.name, cls=QuickCommand, epilog=epilog, context_settings=WIDE)(function)
        words = with_omitted_values(args, self._entry.omitted)
        return typer.main.get_command(single).make_context(info_name, words, parent, **extra)


def with_omitted_values(args: list[str], omitted: Mapping[str, str]) -> list[str]:
    """Returns the arguments with the `omitted` values, by option: Typer has no options with an optional value.

    A number that follows such an option is its value.
    """
    return [
        f"{arg}={omitted[arg]}" if arg in omitted and not "".join(args[k : k + 1]).isdecimal() else arg
        for k, arg in enumerate(args, 1)
    ]


class Commands(TyperGroup):
    """The group of all commands of the table."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, entry in COMMANDS.items():
            self.add_command(DeferredCommand(name, entry), name)

    def get_params(self, ctx: Any) -> list[Any]:
        return [quick(parameter) for parameter in super().get_params(ctx)]

    def invoke(self, ctx: Any) -> Any:
        """Runs a command. Click would print "Aborted!" for an EOFError, such as one of a damaged file."""
        try:
            return super().invoke(ctx)
        except EOFError as error:
            raise RuntimeError(f"a file ends too early: {error}") from error

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Writes each group with its commands and one example."""
        width = max(map(len, COMMANDS))
        for title, group in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), entry.summary) for name, entry in group.items()])
                formatter.write_paragraph()
                formatter.write_text(f"Example: {next(iter(group.values())).example}")


app = typer.Typer(
    name="hyperbit",
    help="Drives arms made of many two-state actuators: goals over Zenoh in, switch commands over CANopen out.",
    cls=Commands,
    context_settings=WIDE,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # the import of rich takes longer than the rest of `--help`
)


def print_version(requested: bool) -> None:
    """Prints the version and exits, if `--version` was given."""
    if requested:
        from importlib.metadata import version

        sys.stdout.write(f"hyperbit {version('hyperbit')}\n")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Accepts the options that precede a command."""


def fill_streams() -> None:
    """Opens /dev/null for each missing standard stream, also for children. Call it before anything opens a file."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # it gets the lowest free number
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


def main() -> None:
    """Runs the command line; an error that the user can correct becomes a message and an exit code."""
    fill_streams()
    exit_on_signals()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # of terminals that are not UTF-8
    try:
        app()
    except Exception as error:
        from hyperbit.controller.armfile.strict import InputFaults
        from hyperbit.controller.commands.common import CommandFailed

        if isinstance(error, RuntimeError) and REFUSAL in str(error):
            error = CommandFailed(f"numba cannot write its machine code: {ADVICE}")
        if isinstance(error, OSError) and error.errno in FULL:
            where = "" if error.filename is None else f"{error.filename}: "
            error = CommandFailed(f"{where}{error.strerror}", "free it, and start the command again")
        elif isinstance(error, OSError) and error.errno in UNUSABLE:
            error = CommandFailed(f"{error.filename}: {error.strerror}")
        if not isinstance(error, InputFaults | CommandFailed):
            raise
        sys.stderr.write(f"{error}\n")
        sys.exit(2 if isinstance(error, InputFaults) else 1)


if __name__ == "__main__":
    main()
