"""The command that runs simulated boards: simulate."""

import signal
import sys
import threading
from typing import TYPE_CHECKING

from controller.commands.common import ArmFile, Failed, console, errors

if TYPE_CHECKING:
    from drivers.simulation.simulation import Simulation


def simulate(file: ArmFile) -> None:
    """Run simulated boards on the arm's own bus, in place of the real ones, until SIGTERM."""
    from controller.executor.arm import read_arm

    arm = read_arm(file)

    import can

    from drivers.simulation import fault_commands
    from drivers.simulation.simulation import Simulation

    ending = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ending.set())
    try:
        simulation = Simulation(arm.wiring, arm.timing)
    except (can.CanError, OSError) as error:
        raise Failed(f"the bus cannot be opened: {error}") from None
    simulation.start()
    try:
        names = ", ".join(f"{bus.name} ({bus.interface} {bus.channel})" for bus in arm.wiring.buses)
        console.print(f"simulating the boards of {arm.name} on {names}\n{fault_commands.HELP}")
        threading.Thread(target=obey, args=(simulation,), daemon=True).start()
        ending.wait()
    finally:
        simulation.stop()


def obey(simulation: "Simulation") -> None:
    """Makes the faults that lines on standard input ask for."""
    for line in sys.stdin:
        try:
            simulation.fault(*line.split())
            console.print(f"done: {line.strip()}")
        except (KeyError, ValueError) as error:
            errors.print(f"not done: {error}")
