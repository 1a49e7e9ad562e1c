"""Faults of buses and of the executor's controllers, other masters on a bus, and pauses of the executor."""

from __future__ import annotations

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame, State
from hyperbit.drivers.canopen.wire.events import BusOverrun
from tests.simulation.faults.fault import AT_ONCE, Fault, Place, Told, row


def _bus(at: Place, code: str, words: str) -> Told:
    return Told((code,), (at.bus.name,), (words,), AT_ONCE, lost=at.here, clears=True, beats=False)


def _stuck(at: Place) -> Told:
    within = at.timing.heartbeat_timeout + at.timing.heartbeat + 0.1
    sources = (at.bus.name, *at.here)
    return Told(("bus-busy",), sources, (), within, ("board-lost",), lost=at.here, clears=True, beats=False)


@row("bus", anytime=True)
def bus_is_down(at: Place) -> Fault:
    return Fault(at.bus.go_down, at.bus.restore, _bus(at, "bus-down", "is down"))


@row("bus", anytime=True)
def bus_is_off(at: Place) -> Fault:
    return Fault(at.bus.go_off, at.bus.restore, _bus(at, "bus-off", "bus-off"))


@row("bus", anytime=True)
def bus_is_unacknowledged(at: Place) -> Fault:
    return Fault(at.on_bus("acknowledged", False), at.bus.restore, _stuck(at))


@row("bus", anytime=True, longest=0.3)
def queue_is_full(at: Place) -> Fault:
    return Fault(at.on_bus("capacity", 0), at.bus.restore, _stuck(at))


@row("bus")
def queue_is_full_for_a_moment(at: Place) -> Fault | None:
    """The next frame cannot be sent, and is sent again."""
    period = at.timing.heartbeat
    if at.timing.heartbeat_timeout < 3 * period or period < 0.05:
        return None

    def begin() -> None:
        at.bus.room = 0
        at.after(period + 0.005, at.on_bus("room", None))

    return Fault(begin, at.bus.restore, Told(within=3 * period, beats=False))


@row("bus", anytime=True)
def bus_is_passive(at: Place) -> Fault:
    words = ("128 transmit",)
    return Fault(
        at.bus.warn, at.bus.restore, Told(("bus-passive",), (at.bus.name,), words, 0.1, clears=True, warns=True)
    )


@row("bus", anytime=True, longest=0.5)
def frames_are_lost(at: Place) -> Fault:
    return Fault(at.on_bus("loss", at.random.choice([0.01, 0.1])), at.bus.restore, None)


@row("bus", anytime=True, longest=2.0)
def frames_come_twice(at: Place) -> Fault:
    return Fault(at.on_bus("duplication", 0.2), at.bus.restore)


@row("bus", anytime=True, longest=2.0)
def answers_are_late(at: Place) -> Fault:
    return Fault(at.on_bus("answer_delay", 0.05), at.bus.restore)


@row("bus", anytime=True, longest=2.0)
def answers_are_very_late(at: Place) -> Fault:
    return Fault(at.on_bus("answer_delay", 0.8), at.bus.restore, None)


@row("bus", anytime=True, longest=3.0)
def answers_are_lost(at: Place) -> Fault:
    return Fault(at.on_bus("mute", True), at.bus.hear_answers, None)


@row("bus", anytime=True)
def echoes_are_lost(at: Place) -> Fault:
    return Fault(at.on_bus("echoes", False), at.bus.restore, None)


@row("bus", anytime=True)
def frames_are_overrun(at: Place) -> Fault:
    def begin() -> None:
        for k in range(at.random.choice([1, 10])):
            at.after(0.02 * k, at.tell(BusOverrun(at.bus.name)))

    return Fault(begin)


@row("bus", anytime=True)
def another_master_sends(at: Place) -> Fault:
    frames = {"SYNC": Frame(cia301.SYNC), "NMT": Frame(cia301.NMT, b"\x01\x00"), "heartbeat": Frame(0x77F, b"\x05")}
    if at.judged.rpdos:
        frames["an RPDO"] = Frame(at.judged.rpdos[0], bytes(8))
    what = at.random.choice(list(frames))
    words = (what, f"frame {frames[what].id:03X}h", "only one may switch")
    return Fault(at.post(frames[what]), told=Told(("foreign-master",), (at.bus.name,), words, AT_ONCE))


@row("bus", anytime=True)
def device_with_the_masters_node_id_boots(at: Place) -> Fault:
    words = (f"a device on {at.bus.name} has node id 127", "77Fh", "hyperbit node-id")
    state = at.random.choice([State.BOOT_UP, State.PRE_OPERATIONAL, State.STOPPED])
    return Fault(at.post(Frame(0x77F, bytes([state]))), told=Told(("duplicate-node",), (at.bus.name,), words, AT_ONCE))


@row("executor", anytime=True)
def executor_stands_still(at: Place, long: float = 0.0) -> Fault:
    long = long or at.timing.heartbeat_timeout * at.random.choice([1.3, 2.0]) + at.random.choice([0.0, 0.0, 1.0])
    everything = tuple(at.boards.simulated.names)
    also = ("board-stopped", "board-lost", "emergency", "board-error", "bus-busy")
    told = Told(("halted",), (), (), long + AT_ONCE + 0.1, also, lost=everything, beats=False)
    return Fault(lambda: at.world.stall(long), told=told)


@row("executor", anytime=True)
def executor_stalls_for_a_moment(at: Place) -> Fault:
    short = 0.7 * (at.timing.heartbeat_timeout - at.timing.heartbeat)
    return Fault(lambda: at.world.stall(short), told=Told(within=short + 0.2, beats=False))


@row("executor", anytime=True)
def executor_is_killed(at: Place, dead: float | None = None) -> Fault:
    """The next process boots the boards."""
    return Fault(lambda: at.world.kill(at.random.choice([0.05, 0.2, 1.0]) if dead is None else dead), told=None)


@row("bus", anytime=True)
def TPDO_of_a_board_is_lost(at: Place) -> Fault:
    return Fault(at.on_bus("tpdos_to_lose", 1), at.on_bus("tpdos_to_lose", 0), None)


@row("bus", anytime=True)
def frame_of_random_bytes(at: Place) -> Fault:
    own = [function + at.node for function in (0x80, 0x180, 0x580, 0x580, 0x700)]
    cob_id = at.random.choice([at.random.randrange(0x800), 0x77F, 0x80, *own])
    return Fault(at.post(Frame(cob_id, at.random.randbytes(at.random.randint(0, 8)))), told=None)
