"""The command `simulate`: runs simulated boards."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import ArmFile
from hyperbit.controller.commands.common import CommandFailed, console, errors
from hyperbit.controller.commands.process import ending_event
from hyperbit.drivers.simulation.variants import VARIANTS, Variant, choose

if TYPE_CHECKING:
    from hyperbit.drivers.simulation.simulation import Simulation

WIDEST = max(map(len, VARIANTS))
LONGEST_LINE = 1_000  # bytes of a line of the standard input; the rest is taken for another line
BOARD = "Kind of the boards: KIND for all, or BOARD=KIND for one, such as can0/5=guarding-only; repeatable."


def simulate(
    file: ArmFile,
    board: Annotated[list[str], typer.Option(metavar="[BOARD=]KIND", help=BOARD, show_default=False)] = [],  # noqa: B006  # typer needs a list
) -> None:
    """Run simulated boards on the arm's own bus, in place of the real boards, until SIGTERM."""
    from hyperbit.controller.executor.arm.arm import read_arm

    arm = read_arm(file)

    import can

    from hyperbit.drivers.simulation import fault_commands
    from hyperbit.drivers.simulation.buses import board_names
    from hyperbit.drivers.simulation.simulation import Simulation

    variants = variants_of(board, board_names(arm.wiring))
    ending = ending_event()
    try:
        simulation = Simulation(arm.wiring, arm.timing, variants=variants)
    except (can.CanError, OSError) as error:
        raise CommandFailed(f"the bus cannot be opened: {error}") from None
    simulation.start()
    try:
        names = ", ".join(f"{bus.name} ({bus.interface} {bus.channel})" for bus in arm.wiring.buses)
        console.print(f"simulating the boards of {arm.name} on {names}\nfaults to type:\n{fault_commands.described()}")
        threading.Thread(target=obey, args=(simulation,), daemon=True).start()
        ending.wait()
    finally:
        simulation.stop()


simulate.__doc__ = f"{simulate.__doc__}\n\n\b\nKinds of boards:\n" + "\n".join(
    f"  {name:{WIDEST}} {variant.text}" for name, variant in VARIANTS.items()
)


def variants_of(board: list[str], boards: list[str]) -> dict[str, Variant]:
    """Returns the kinds of simulated boards that the option --board names, for the boards of an arm."""
    try:
        return choose(board, boards)
    except ValueError as error:
        raise InputFaults(Path("--board"), [str(error)]) from None


def obey(simulation: Simulation) -> None:
    """Injects the faults that lines on standard input name."""
    for line in iter(lambda: sys.stdin.buffer.readline(LONGEST_LINE).decode(errors="replace"), ""):
        try:
            if line.strip():
                console.print(simulation.play_fault(line))
        except ValueError as error:
            errors.print(f"not done: {error}")
