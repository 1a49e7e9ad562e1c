"""The boards' connection to a bus whose interface is lost and comes back."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from hyperbit.drivers.canopen.wire.bus import read_error
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import BusWiring
from hyperbit.drivers.simulation.simulation import Port
from tests.emulated import Interface
from tests.waiting import eventually


@pytest.fixture
def interface() -> Iterator[Interface]:
    with tempfile.TemporaryDirectory(prefix="can") as folder:  # of a short name, for the socket in it
        interface = Interface(Path(folder))
        yield interface
        interface.close()


def test_a_port_whose_board_speaks_first_when_its_interface_is_gone_is_opened_again(interface: Interface) -> None:
    settings = BusWiring("can0", "emulated", interface.channel)
    port = Port(settings)
    interface.delete()
    port.send_frame(Frame(0x701, b"\5"))  # the only word of its socket that the interface is gone
    interface.make()
    port.receive_frame(0.0)
    with can.Bus(interface="emulated", channel=interface.channel, ignore_config=True) as other:

        def heard() -> bool:
            other.send(can.Message(arbitration_id=0x80, is_extended_id=False))
            return port.receive_frame(0.1) is not None

        eventually(heard)
    port.close()


def test_bus_off_is_reported_as_socketcan_does_it(interface: Interface) -> None:
    port = Port(BusWiring("can0", "emulated", interface.channel))
    with can.Bus(interface="emulated", channel=interface.channel, ignore_config=True) as other:
        told = list[str | None]()
        for state in ("bus-off", "active"):
            port.send_error(state)
            message = eventually(lambda: other.recv(0.1))
            assert message.is_error_frame
            told.append(read_error(message.arbitration_id, bytes(message.data))[0])
    assert told == ["bus-off", "active"]
    port.close()
