"""The `hyperbit` command. Exit codes: 0 done, 1 the request failed, 2 unusable input, 130 interrupted.

A command's module is imported when the command runs, so that `hyperbit stop` does not wait for the search's kernels.
"""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from controller.commands.groups import EXAMPLES, GROUPS


class Entry(NamedTuple):
    """Where a command is implemented.

    Attributes:
        module: name of the module in `controller.commands`.
        function: name of the function in the module.
        summary: first line of the function's docstring.
    """

    module: str
    function: str
    summary: str


COMMANDS = {
    "run": Entry("run", "run", "Run the daemon: goals over Zenoh to an executor, which moves the arm, until SIGTERM."),
    "execute": Entry(
        "execute", "execute", "Run the executor: motion programs from a planner to boards over CAN, until SIGTERM."
    ),
    "simulate": Entry(
        "simulate", "simulate", "Run simulated boards on the arm's own bus, in place of the real ones, until SIGTERM."
    ),
    "demo": Entry(
        "demo",
        "demo",
        "Run the whole chain on simulated boards: three targets, then a closed curve, a table and a picture.",
    ),
    "send": Entry("talk", "send", "Send a goal and follow it to its result; Ctrl-C cancels the goal."),
    "watch": Entry("talk", "watch", "Show a running arm until interrupted; with --json, print a line for each state."),
    "record": Entry(
        "record", "record", "Record all that an arm publishes, and its requests, to MCAP files until SIGTERM."
    ),
    "replay": Entry(
        "replay",
        "replay",
        "Republish a recording below another prefix, or send its goals to a simulated arm and compare.",
    ),
    "cancel": Entry(
        "tell", "cancel", "End the running goal or stream of set-points; the arm holds and accepts the next."
    ),
    "stop": Entry(
        "tell",
        "stop",
        "Stop the arm: it holds and accepts no motion until reset. No substitute for a switch that cuts the power.",
    ),
    "halt": Entry(
        "halt",
        "halt",
        "Stop the arm as `stop`, or --local past planner and Zenoh. No substitute for a switch that cuts the power.",
    ),
    "reset": Entry("tell", "reset", "Leave a stop or a fault; nothing moves."),
    "degrade": Entry("tell", "degrade", "Lock actuators that are stuck, or unlock them; nothing moves."),
    "lock": Entry(
        "tell", "lock", "Lock actuators in a state, or unlock them with `free`; nothing moves. The same as `degrade`."
    ),
    "jog": Entry("jog", "jog", "Switch single actuators, also if the arm is in no configuration. The arm moves."),
    "exercise": Entry(
        "exercise",
        "exercise",
        "Move each actuator once there and back, one at a time, and propose travel times for the arm's file.",
    ),
    "obstacles": Entry(
        "tell",
        "obstacles",
        "Send obstacles in place of those sent before; those of the arm's file remain. Nothing moves.",
    ),
    "plan": Entry("plan", "plan", "Search configurations for goals, without any hardware."),
    "fk": Entry("report", "fk", "Print position and orientation of the tip for a configuration."),
    "map": Entry("report", "map_", "Map the point densities of all intermediate workspaces into the cache."),
    "workspace": Entry(
        "workspace",
        "workspace",
        "Draw and report where an arm can reach: positions, orientations at a point, and with locked actuators.",
    ),
    "figure5": Entry(
        "report", "figure5", "Repeat the paper's experiment of section 4: three targets, three algorithms."
    ),
    "bench": Entry(
        "bench", "bench", "Compare methods of inverse kinematics on goals whose fewest switches are proven."
    ),
    "check": Entry(
        "health", "check", "Check an arm's file and name each fault by its field; --bus also reads the boards."
    ),
    "probe": Entry("probe", "probe", "Find the nodes of a CAN bus and print what each is and holds; writes nothing."),
    "node-id": Entry(
        "node_id",
        "node_id",
        "Set a board's node id and bit rate by LSS, and store them; they count from the next power-on.",
    ),
    "board": Entry("board", "board", "Read the errors of one board, or reset it, while the arm's executor is stopped."),
    "panel": Entry(
        "panel",
        "panel",
        "Serve the operator's page, which shows and commands all arms that it is connected to, until SIGTERM.",
    ),
    "wear": Entry("health", "wear", "Print how often each actuator has switched, and how goals ended."),
    "calibrate": Entry(
        "calibrate",
        "calibrate",
        "Fit the numbers of an arm's file, modules and base, to measured tips; report what they miss before and after.",
    ),
}


WIDE = {"max_content_width": 120}  # columns of --help, on terminals that have them


class PlainValue:
    """Takes texts and paths as they are written, and other values as Typer does.

    Typer checks them by pydantic, whose import takes longer than all else that `hyperbit stop` does.

    Args:
        kind: of the value.
        usual: returns what takes values for Typer.
    """

    def __init__(self, kind: object, usual: Callable[[], Any]) -> None:
        self._kind, self._usual = kind, usual

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Returns the value of a parameter; see typer's RuntimeParam."""
        if param.nargs == 1 and not param.multiple:
            if value is None:
                return None
            if self._kind in (str, Path):
                return self._kind(value)
        return self._usual().coerce(value, param=param, ctx=ctx)


class QuickCommand(TyperCommand):
    """A command whose texts and paths are taken as they are written."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Returns the parameters."""
        return [quick(parameter) for parameter in super().get_params(ctx)]


def quick(parameter: Any) -> Any:
    """Returns a parameter whose values PlainValue takes."""
    if "get_runtime_param" not in vars(parameter):
        taken = PlainValue(parameter.type_descriptor.annotation, parameter.get_runtime_param)
        parameter.get_runtime_param = lambda: taken
    return parameter


class DeferredCommand(TyperCommand):
    """A command whose module is imported when its arguments are parsed."""

    def __init__(self, name: str, entry: Entry) -> None:
        """Keeps where the command is implemented."""
        super().__init__(name, help=entry.summary)
        self._entry = entry

    def get_short_help_str(self, limit: int = 0) -> str:
        """Returns the whole summary: the list of commands wraps it."""
        return self._entry.summary

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Returns the context of the imported command, which the group then invokes in place of this one."""
        module = importlib.import_module(f"controller.commands.{self._entry.module}")
        single = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
        epilog = f"Example: {EXAMPLES[self.name]}" if self.name in EXAMPLES else None
        single.command(self.name, cls=QuickCommand, epilog=epilog, context_settings=WIDE)(
            getattr(module, self._entry.function)
        )
        return typer.main.get_command(single).make_context(info_name, args, parent, **extra)


class Commands(TyperGroup):
    """The commands of the table; `--help` shows them in groups."""

    def __init__(self, **settings: Any) -> None:
        """Adds the deferred commands."""
        super().__init__(**settings)
        for name, entry in COMMANDS.items():
            self.add_command(DeferredCommand(name, entry), name)

    def get_params(self, ctx: Any) -> list[Any]:
        """Returns the parameters that precede a command."""
        return [quick(parameter) for parameter in super().get_params(ctx)]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Writes each group with its commands and one example."""
        width = max(map(len, COMMANDS))
        for title, examples in GROUPS.items():
            with formatter.section(title):
                shown = [name for name in examples if name in COMMANDS]
                formatter.write_dl([(name.ljust(width), COMMANDS[name].summary) for name in shown])
                formatter.write_paragraph()
                formatter.write_text(f"Example: {next(iter(examples.values()))}")


app = typer.Typer(
    name="hyperbit",
    help="Drives arms made of many two-state actuators: goals over Zenoh in, switch commands over CANopen out.",
    cls=Commands,
    context_settings=WIDE,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich's help takes longer to import than all else that `--help` needs
)


def print_version(wanted: bool) -> None:
    """Prints the version and exits, if it is wanted."""
    if wanted:
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


def main() -> None:
    """Runs the command line; errors that the user can correct become a message and an exit code."""
    try:
        app()
    except Exception as error:
        from controller.commands.common import Failed
        from controller.strict import InputFaults

        if not isinstance(error, InputFaults | Failed):
            raise
        sys.stderr.write(f"{error}\n")
        sys.exit(2 if isinstance(error, InputFaults) else 1)


if __name__ == "__main__":
    main()
