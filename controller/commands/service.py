"""Commands that run things: run and simulate."""

import contextlib
import logging
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from controller.commands.common import ENDPOINT, ArmFile, Failed, ZenohFile, console, densities_of, errors, load_wired
from controller.strict import InputFaults

if TYPE_CHECKING:
    from drivers.simulation.simulation import Simulation


def run(
    file: ArmFile,
    simulate: Annotated[bool, typer.Option("--simulate", help="Embedded boards on a virtual bus.")] = False,
    listen: Annotated[str, typer.Option(help="Zenoh endpoint to accept connections at.")] = ENDPOINT,
    zenoh_file: ZenohFile = None,
    ledger: Annotated[Path | None, typer.Option(help="Where the ledger is kept.")] = None,
) -> None:
    """Run the daemon: goals over Zenoh to boards over CAN, until SIGTERM."""
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    # The control loop must not wait for the planner's share of the interpreter, which is 5 ms by default.
    sys.setswitchinterval(0.0005)
    arm = load_wired(file)

    import zenoh

    from controller.daemon import service, session
    from controller.daemon.ledger import default_path
    from drivers.faults import BusError

    try:
        config = session.from_file(zenoh_file) if zenoh_file else session.configuration("peer", listen=listen)
    except ValueError as error:
        raise InputFaults(Path("--zenoh"), [str(error)]) from None
    densities = densities_of(arm)
    wiring, timing = service.wiring_of(arm), service.timing_of(arm)
    with contextlib.ExitStack() as stack:
        if simulate:
            wiring, timing = service.embedded(wiring), service.patient(timing)
            stack.enter_context(service.simulated(wiring, timing))
        try:
            book = ledger or default_path(arm.settings.name)
            daemon = service.Daemon(arm, densities, wiring, config, book, timing)
        except BusError as error:
            raise Failed(str(error)) from None
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0].strip()  # the rest is where in Zenoh's source
            raise Failed(f"no Zenoh session at {zenoh_file or listen}: {reason}") from None
        service.run_until_signal(daemon)


def simulate(file: ArmFile) -> None:
    """Run simulated boards on the arm's own bus, in place of the real ones, until SIGTERM."""
    arm = load_wired(file)

    import can

    from controller.daemon import service
    from drivers.simulation import fault_commands

    ending = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ending.set())
    wiring = service.wiring_of(arm)
    try:
        with service.simulated(wiring, service.timing_of(arm)) as simulation:
            names = ", ".join(f"{bus.name} ({bus.interface} {bus.channel})" for bus in wiring.buses)
            console.print(f"simulating the boards of {arm.settings.name} on {names}\n{fault_commands.HELP}")
            threading.Thread(target=obey, args=(simulation,), daemon=True).start()
            ending.wait()
    except (can.CanError, OSError) as error:
        raise Failed(f"the bus cannot be opened: {error}") from None


def obey(simulation: "Simulation") -> None:
    """Makes the faults that lines on standard input ask for."""
    for line in sys.stdin:
        try:
            simulation.fault(*line.split())
            console.print(f"done: {line.strip()}")
        except (KeyError, ValueError) as error:
            errors.print(f"not done: {error}")
