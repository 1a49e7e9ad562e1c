"""The transmit echo: handed out frames are recognized when they are echoed."""

from __future__ import annotations

from hyperbit.drivers.canopen.wire.cia301 import REMOTE, Frame
from hyperbit.drivers.canopen.wire.link import Link, Outgoing, TxPending
from hyperbit.drivers.canopen.wiring import BusWiring

BEAT = Frame(0x77F, b"\x05")


def test_the_first_frame_is_ours_however_late_it_comes_back():
    pending = TxPending()
    for k in range(3):
        pending.sent(BEAT, 0.7 * k)
        pending.give_up(0.7 * k - 1.0)
    assert [pending.came_back(BEAT, 3.0) for _ in range(4)] == [[BEAT], [BEAT], [BEAT], []]
    assert pending.last_echo == 3.0


def test_nothing_is_pending_before_the_first_echo():
    pending = TxPending()
    pending.sent(BEAT, 0.0)
    assert (pending.count, pending.oldest) == (0, None)
    pending.came_back(BEAT, 0.1)
    pending.sent(BEAT, 0.2)
    assert (pending.count, pending.oldest) == (1, 0.2)
    pending.failed(BEAT)
    assert pending.count == 0
    pending.sent(BEAT, 0.3)
    pending.forget()
    assert not pending.came_back(BEAT, 0.4)


def test_the_echo_of_a_later_frame_of_lower_priority_shows_that_an_echo_was_lost():
    pending = TxPending()
    rpdo, poll = Frame(0x205, b"\x01"), Frame(REMOTE | 0x705)
    for frame in (BEAT, rpdo, poll, BEAT):
        pending.sent(frame, 0.0)
    assert pending.came_back(poll, 0.1) == [rpdo, poll]  # the first heartbeat has less priority than the poll
    assert [pending.came_back(BEAT, 0.2) for _ in range(2)] == [[BEAT], [BEAT]]
    assert pending.came_back(rpdo, 0.3) == [rpdo]  # it was only late


def test_a_frame_of_another_program_with_the_same_identifier_is_not_ours():
    pending = TxPending()
    pending.sent(Frame(0x205, b"\x01"), 0.0)
    pending.came_back(Frame(0x205, b"\x01"), 0.1)
    pending.sent(Frame(0x205, b"\x02"), 0.2)
    assert pending.came_back(Frame(0x205, b"\x03"), 0.3) == []
    assert pending.holds(0x205)


def test_a_frame_that_was_handed_out_after_the_echoed_one_stays_pending():
    pending = TxPending()
    rpdo = Frame(0x205, b"\x01")
    pending.sent(BEAT, 0.0)
    pending.sent(rpdo, 0.0)
    assert pending.came_back(BEAT, 0.1) == [BEAT]
    assert pending.holds(0x205)
    assert not pending.holds(0x206)


def opened(stuck_after: float = 0.4) -> tuple[Link, list[Frame]]:
    """Returns the link of a bus whose echoes are waited for, and the frames that it sends from now on."""
    sent: list[Frame] = []
    link = Link(BusWiring("can0", "none", ""), lambda bus, frame: sent.append(frame), stuck_after)
    link.changed("active", "", None, 0.0)
    link.send_frame(BEAT, 0.0)
    assert link.echoed(BEAT, 0.001)
    sent.clear()
    return link, sent


def test_a_bus_is_stuck_after_its_own_time():
    link, _ = opened(stuck_after=1.2)
    assert link.rearm() is None
    faults = []
    for k in range(1, 200):
        link.send_frame(BEAT, 0.01 * k)
        if (fault := link.tick(0.01 * k, 0.01 * k)) is not None:
            faults.append((k, fault.code))
    assert faults == [(122, "bus-busy")]
    assert not link.armed


def test_transfers_wait_until_the_heartbeat_has_left():
    """On a slow bus SDO frames would delay the heartbeat, whose identifier is the highest of all."""
    link, sent = opened()
    link.send_frame(BEAT, 0.1)
    request = Frame(0x601, bytes(8))
    link.queue(Outgoing(request), 0.101)
    assert sent == [BEAT]
    link.echoed(BEAT, 0.102)
    assert sent == [BEAT, request]


def test_a_poll_of_node_guarding_does_not_wait_for_a_command():
    link, sent = opened()
    command, request, poll = Frame(0x205, b"\x01"), Frame(0x605, bytes(8)), Frame(REMOTE | 0x705)
    link.send_frame(command, 0.2)
    link.queue(Outgoing(request), 0.2)
    link.queue(Outgoing(poll), 0.2, urgent=True)
    assert sent == [command, poll]
    link.echoed(command, 0.21)
    assert sent[2:] == [request]


def test_transfers_go_on_after_the_echo_of_a_heartbeat_was_lost():
    link, sent = opened()
    for k in (1, 2):
        link.send_frame(BEAT, 0.1 * k)
    link.echoed(BEAT, 0.201)
    request = Outgoing(Frame(0x605, bytes(8)))
    link.queue(request, 0.25)
    link.send_frame(BEAT, 0.3)
    link.echoed(BEAT, 0.301)
    assert sent[-1] == request.frame
    assert link.pending.came_back(BEAT, 0.4) == [BEAT]  # the echo that was late
