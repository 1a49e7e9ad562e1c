"""The model of a bus: what the executor can know of lost echoes."""

from __future__ import annotations

from random import Random

from hyperbit.drivers.canopen.run.heartbeat import BEAT
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.agenda import Agenda
from tests.simulation.buses.bus_model import BusModel

RPDO, REQUEST = Frame(0x201, b"\x01"), Frame(0x601, bytes(8))


def test_the_executor_learns_of_a_lost_command_by_the_echo_of_a_heartbeat() -> None:
    agenda = Agenda()
    bus = BusModel("can0", 1_000_000, agenda, Random(0), lambda *_: None, lambda _: None)

    def owed(frame: Frame, echoes: bool) -> bool:
        bus.echoes = echoes
        bus.send_frame(frame)
        agenda.run(0.01)
        return bus.echo_owed

    assert not owed(BEAT, False), "no command is unknown"
    assert not owed(RPDO, False), "the executor sends a heartbeat that tells"
    assert owed(BEAT, False)
    assert owed(REQUEST, True)
    assert not owed(BEAT, True)
    assert not owed(BEAT, False)
