"""Output lines: which frames go before a SYNC, and which lines are still to be read."""

from __future__ import annotations

from hyperbit.drivers.canopen.boards.outputs import Key, OutputLines
from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, NodeWiring, Wiring

FIRST, SECOND = ("can0", 0x205), ("can0", 0x209)
PULSED = 0b01


def lines(**node: bool) -> OutputLines:
    """Two boards with an output each; the first one's is pulsed."""
    channels = (Channel("5.left", "can0", 5, 0, None), Channel("9.left", "can0", 9, 0, None))
    wiring = Wiring((BusWiring("can0", "virtual", "can0"),), channels, nodes=(NodeWiring("can0", 5, **node),))
    outputs = OutputLines(lay_out(wiring), PULSED)
    switch(outputs, 0, FIRST, SECOND)
    return outputs


def latch(outputs: OutputLines, states: int, *keys: Key) -> None:
    for key in keys:
        outputs.sent(key, outputs.send(key, states), states)


def switch(outputs: OutputLines, states: int, *keys: Key) -> None:
    latch(outputs, states, *keys)
    outputs.switched("can0", states)


def test_bytes_that_a_board_has_latched_in_vain_are_replaced() -> None:
    outputs = lines()
    assert outputs.due(0) == {}
    latch(outputs, 0b01, FIRST)
    assert outputs.due(0) == {"can0": [FIRST]}


def test_the_frame_of_a_line_that_may_be_on_goes_before_the_next_sync() -> None:
    outputs = lines()
    assert outputs.due(0b10) == {"can0": [SECOND]}
    outputs.mistrust(PULSED)
    assert outputs.due(0b10) == {"can0": [FIRST, SECOND]}


def test_the_end_of_a_pulse_is_to_be_read_also_at_a_board_that_is_not_verified() -> None:
    outputs = lines(verify=False)
    switch(outputs, PULSED, FIRST)
    assert (outputs.unread, outputs.released) == (0, 0)
    switch(outputs, 0, FIRST)
    assert outputs.released == PULSED
