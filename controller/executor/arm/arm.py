"""The executor's view of the arm: actuators, wiring and times, read from the arm's file."""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from hyperbit.controller.armfile.actuators import ending_time, longest_travel, read_wired, travel_times
from hyperbit.controller.armfile.commissioned import warning_of
from hyperbit.controller.armfile.error_states import error_state
from hyperbit.controller.armfile.locks import STATES
from hyperbit.controller.armfile.places import placed_faults
from hyperbit.controller.armfile.settings import ActuatorSettings, ArmSettings, InterlockSettings, RealTimeSettings
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.terminals import actuator_terminals, interlock_bit, owned_terminals
from hyperbit.controller.executor.arm.kinds import mask_of
from hyperbit.controller.host.files import read_file
from hyperbit.drivers.canopen.layout import Unfit, lay_out
from hyperbit.drivers.canopen.wiring import (
    BoardId,
    BusWiring,
    Channel,
    Interlock,
    NodeWiring,
    Timing,
    WatchedObject,
    Wiring,
)


@dataclass(frozen=True)
class ExecutedArm:
    """An arm of A actuators. Actuator k is bit k of integers of states and of masks."""

    name: str
    wiring: Wiring
    timing: Timing
    inrush: int | None = None  # most actuators that may switch at once; None: no limit
    rest: float = 0.0  # of an actuator between two travels [s]
    planner_timeout: float = 1.0  # after this silence of the planner the program ends and the arm holds [s]
    locked: int = 0  # mask of the actuators that the file declares stuck
    locked_states: int = 0  # their states
    continue_on_stuck: bool = False  # lock a stuck actuator and continue, instead of staying in fault
    contract_on_stop: bool = False  # contract all actuators before the executor ends
    ending: float = 10.0  # longest time of that contraction [s]
    real_time: RealTimeSettings | None = None
    uncommissioned: str | None = field(default=None, compare=False)  # which actuators nobody has commissioned, in words
    digest: str = ""  # SHA-256 of the file, in hexadecimal

    @cached_property
    def actuators(self) -> tuple[str, ...]:
        """Their labels, shape (A,)."""
        return tuple(channel.actuator for channel in self.wiring.channels)

    @property
    def most(self) -> int:
        return len(self.actuators) if self.inrush is None else self.inrush


def read_arm(path: Path) -> ExecutedArm:
    """Reads an arm's file that maps actuators to boards.

    Raises:
        InputFaults: the file is missing or wrong; one line for each fault, with the path of its field.
    """
    settings, actuators, wired = read_wired(path)
    wiring = wiring_of(settings, actuators, wired)
    with placed_faults(path):
        try:
            lay_out(wiring)
        except Unfit as misfit:
            for where, _, it in owned_terminals(settings):
                if (it.kind, it.board, it.bit // 8) == (misfit.kind, misfit.board, misfit.byte):
                    raise InputFaults(path, [f"{where}: {it.bit}, but {misfit}"]) from None
    return ExecutedArm(
        name=settings.name,
        wiring=wiring,
        timing=timing_of(settings),
        inrush=settings.inrush,
        rest=settings.rest_time,
        planner_timeout=settings.planner_timeout,
        locked=mask_of(k for k, entry in enumerate(wired) if entry.stuck is not None),
        locked_states=mask_of(k for k, entry in enumerate(wired) if entry.stuck == STATES[1]),
        continue_on_stuck=settings.on_stuck == "continue",
        contract_on_stop=settings.on_stop == "contract",
        ending=ending_time(settings, len(actuators)),
        real_time=settings.real_time,
        uncommissioned=warning_of(path, settings, actuators, wired),
        digest=hashlib.sha256(read_file(path)).hexdigest(),
    )


def wiring_of(settings: ArmSettings, actuators: tuple[str, ...], wired: tuple[ActuatorSettings, ...]) -> Wiring:
    boards = settings.boards
    return Wiring(
        buses=tuple(BusWiring(it.name, it.interface, it.channel, it.bitrate) for it in settings.buses),
        channels=tuple(channel_of(settings, label, entry) for label, entry in zip(actuators, wired, strict=True)),
        on_loss=boards.on_loss,
        shared_rpdo=boards.shared_rpdo,
        error_state=error_state(boards.error_state),
        nodes=tuple(
            NodeWiring(
                it.bus,
                it.node,
                it.object,
                it.vendor,
                it.product,
                it.revision,
                it.serial,
                error_state(it.error_state),
                it.verify,
            )
            for it in boards.nodes
        ),
        interlocks=tuple(
            Interlock(name, it.bus, it.node, interlock_bit(it) or 0, it.inverted, watched_object(it))
            for name, it in settings.interlocks.items()
        ),
    )


def watched_object(lock: InterlockSettings) -> WatchedObject | None:
    return None if lock.object is None else WatchedObject(lock.object, lock.sub)


def channel_of(settings: ArmSettings, label: str, entry: ActuatorSettings) -> Channel:
    lines = {terminal.field: terminal for terminal in actuator_terminals(entry)}
    bits = {name: line.bit for name, line in lines.items()}
    own = entry.bus, entry.node
    others = {name: BoardId(*line.board) for name, line in lines.items() if line.board != own}
    return Channel(
        actuator=label,
        bus=entry.bus,
        node=entry.node,
        output=bits["output"],
        input=bits.get("input"),
        output_off=bits.get("output_off"),
        input_contracted=bits.get("input_contracted"),
        inverted=frozenset(name for name, line in lines.items() if line.inverted),
        pulse=entry.pulse,
        travel=travel_times(settings, entry),
        settle_margin=entry.settle_margin,
        on_loss=entry.on_loss,
        input_board=others.get("input"),
        input_contracted_board=others.get("input_contracted"),
    )


def timing_of(settings: ArmSettings) -> Timing:
    boards = settings.boards
    return Timing(
        heartbeat=boards.heartbeat,
        heartbeat_timeout=boards.heartbeat_timeout,
        boot_timeout=boards.boot_timeout,
        travel_time=longest_travel(settings),
        settle_margin=boards.settle_margin,
    )
