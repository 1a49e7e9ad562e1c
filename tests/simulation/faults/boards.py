"""Faults of boards that run, and of the frames from and to them."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import BusOverrun, FrameIgnored
from tests.simulation.faults.fault import AT_ONCE, Fault, Place, Told, row
from tests.simulation.verdict import require

ERRORS = (0x2310, 0x3320, 0x8F00, 0x5000, 0xFF01)
NMT = {Command.STOP: "stopped", Command.PRE_OPERATIONAL: "pre-operational"}
RESTARTS = 0.5  # [s] until a board without supply has booted


@row("board")
def answers_are_lost_once(at: Place) -> Fault:
    """An SDO answer that is lost or late is asked for again."""
    left = [at.random.choice([1, 2])]

    def lose(frame: Frame) -> str:
        if not left[0] or not at.is_answer(frame):
            return ""
        left[0] -= 1
        return at.random.choice(["lose", "late"])

    return Fault(at.intercept(lose), at.bus.restore, Told(within=1.5))


@row("board", anytime=True)
def board_is_silent(at: Place) -> Fault:
    timeout = at.timing.heartbeat_timeout
    words = "no answer to node guarding" if at.guarded else "no heartbeat", f"for {timeout:g} s"
    within, least = timeout + at.timing.heartbeat + AT_ONCE, timeout - at.period - AT_ONCE
    told = Told(("board-lost",), (at.name,), words, within, lost=(at.name,), least=least, clears=True)
    return Fault(at.do("silence"), at.do("unsilence"), told)


@row("board")
def board_is_silent_for_a_moment(at: Place) -> Fault | None:
    """Neither side notices: the heartbeats before and after the silence are up to a period away from it."""
    short = at.timing.heartbeat_timeout - 2 * max(at.period, at.timing.heartbeat) - 2 * AT_ONCE
    if short <= 0 or at.timing.heartbeat_timeout < 0.2:
        return None

    def begin() -> None:
        at.boards.fault("silence", at.name)
        at.after(short, at.do("unsilence"))

    return Fault(begin, told=Told(within=short + 0.2))


@row("board")
def toggle_bit_stands_still(at: Place) -> Fault | None:
    if not at.guarded:
        return None
    count = [0]

    def lose(frame: Frame) -> str:
        count[0] += frame.id == cia301.HEARTBEAT + at.node
        return "lose" if frame.id == cia301.HEARTBEAT + at.node and count[0] % 2 else ""

    within = at.timing.heartbeat_timeout + 3 * at.period + AT_ONCE
    words = ("no answer to node guarding",)
    told = Told(("board-lost",), (at.name,), words, within, lost=(at.name,), clears=True)
    return Fault(at.intercept(lose), at.bus.restore, told)


@row("board", anytime=True)
def board_without_supply(at: Place) -> Fault:
    within = 1.2 * at.timing.heartbeat_timeout + at.timing.heartbeat + AT_ONCE
    told = Told(("board-lost",), (at.name,), (), within, ("board-rebooted",), lost=(at.name,))
    return Fault(at.do("power_cut"), at.do("power_on"), told)


@row("board", anytime=True)
def board_restarts(at: Place, off: float | None = None) -> Fault:
    off = at.random.choice([0.0, 0.01]) if off is None else off

    def begin() -> None:
        at.boards.fault("power_cut", at.name)
        if off:
            at.after(off, at.do("power_on"))
        else:
            at.boards.fault("power_on", at.name)

    late = at.board.variant.boot_time
    quick = late < at.timing.heartbeat_timeout - at.period - AT_ONCE
    codes = ("board-rebooted",) if quick else ("board-rebooted", "board-lost")
    also = ("board-changed", "unexpected-motion") if quick else codes  # a read may come before the boot-up message
    also += ("board-error", "emergency") if at.board.variant.errors else ()
    words = ("has restarted",) if quick else ()
    return Fault(begin, at.do("power_on"), Told(codes, (at.name,), words, RESTARTS + late, also, lost=(at.name,)))


@row("board", anytime=True)
def board_leaves_operational(at: Place) -> Fault:
    """Another program commands it, unheard by the executor."""
    command = at.random.choice(list(NMT))
    words = ("without a command", NMT[command])
    told = Told(("board-stopped",), (at.name,), words, at.period + 0.12, ("unexpected-motion",), lost=(at.name,))
    return Fault(lambda: at.world.order(at.name, command), told=told)


@row("board")
def two_boards_send_heartbeats(at: Place) -> Fault | None:
    if at.guarded:
        return None
    running = [True]

    def beat() -> None:
        if running:
            at.bus.from_other(Frame(cia301.HEARTBEAT + at.node, b"\x05"))
            at.after(at.period, beat)

    def end() -> None:
        running.clear()
        at.world.pass_time(21 * at.period)  # the beats of two windows are counted

    within, least = 35 * at.period + 0.2, 5 * at.period
    words = ("two boards", at.name)
    return Fault(beat, end, Told(("duplicate-node",), (at.name,), words, within, lost=(at.name,), least=least))


@row("board")
def some_heartbeats_are_doubled(at: Place) -> Fault | None:
    if at.guarded:
        return None

    def begin() -> None:
        for k in range(3):
            at.after(3 * k * at.period, lambda: at.bus.from_other(Frame(cia301.HEARTBEAT + at.node, b"\x05")))

    return Fault(begin, told=Told(within=13 * at.period))


@row("board", anytime=True)
def emergency(at: Place) -> Fault:
    code, register, size = at.random.choice(ERRORS), at.random.choice([1, 0x80, 0x81]), at.random.choice([8, 8, 3, 2])
    data = (code.to_bytes(2, "little") + bytes([register, 0, 0, 0, 0, 0]))[:size]
    over = at.random.choice([bytes(8), b"\x55" + bytes(7), bytes(2)])
    told = Told(("emergency",), (at.name,), ("it reports", f"({code:04X}h)"), AT_ONCE)
    return Fault(at.post(Frame(0x80 + at.node, data)), at.post(Frame(0x80 + at.node, over)), told)


@row("board")
def emergencies_in_a_storm(at: Place) -> Fault:
    def begin() -> None:
        for _ in range(25):
            code = at.random.choice(ERRORS)
            at.board.send_emergency(code.to_bytes(2, "little") + bytes([1, 0, 0, 0, 0, 0]))

    told = Told(("emergency",), (at.name,), ("it reports",), 0.1)
    silent = at.objects.number(0x1014) >> 31
    return Fault(begin, told=None if silent else told)


@row("board", anytime=True)
def another_master_commands(at: Place, command: Command | None = None) -> Fault:
    """Its NMT command reaches the board and the executor."""
    if command is None:
        command = Command.PRE_OPERATIONAL if not at.world.moves() else at.random.choice(list(Command))
    frame = Frame(cia301.NMT, bytes([command, at.node]))

    def begin() -> None:
        at.world.order(at.name, command)
        at.post(frame)()

    also = ("board-stopped", "unexpected-motion")
    told = Told(("foreign-master",), (at.bus.name,), ("NMT",), AT_ONCE, also, lost=(at.name,))
    modes = at.objects.has(0x6206) and not at.board.variant.off_outside_operational
    pins: Callable[[], object] = (lambda: at.board.pins) if modes else lambda: None
    return Fault(begin, told=told, holds=pins)


@row("board", anytime=True)
def frames_that_nobody_understands(at: Place) -> Fault:
    free = next(node for node in range(1, 127) if f"{at.bus.name}/{node}" not in at.here)
    beat, answer = cia301.HEARTBEAT + at.node, 0x580 + at.node
    frames = [
        *(Frame(cia301.HEARTBEAT + free, b"\x05"), Frame(0x580 + free, bytes(8)), Frame(0x80 + at.node, b"\x01")),
        *(Frame(beat, b""), Frame(beat, b"\x05\x00"), Frame(beat, b"" if at.guarded else b"\x33")),
        *(Frame(answer, bytes(7)), Frame(0x100, b""), Frame(0x680 + at.node, bytes(8))),
    ]

    drawn, ignored = at.random.sample(frames, 4), list[int]()

    def begin() -> None:
        before = at.world.ignored(at.bus.name)
        for frame in drawn:
            at.post(frame)()
        at.tell(FrameIgnored(at.bus.name, at.random.choice([47, 135])))()  # an extended frame, for instance
        ignored.append(at.world.ignored(at.bus.name) - before)

    def check() -> None:
        require(ignored == [5], f"{ignored} frames are told as ignored: {drawn}, and one of another kind")

    return Fault(begin, check=check)


@row("board", anytime=True)
def inputs_are_short(at: Place) -> Fault | None:
    if (tpdo := _tpdo(at)) is None:
        return None
    size = at.random.randrange(len(tpdo.data))
    words = (f"in {size} bytes, not in {len(tpdo.data)}",)
    return Fault(at.post(Frame(tpdo.id, b"\xff" * size)), told=Told(("wrong-length",), (at.name,), words, AT_ONCE))


@row("board")
def inputs_are_long(at: Place) -> Fault | None:
    """The first bytes of a TPDO count; a warning of limits tells of the others."""
    tpdo = _tpdo(at)
    if tpdo is None or len(tpdo.data) == 8 or at.board.variant.pads:
        return None
    return Fault(at.post(tpdo._replace(data=tpdo.data.ljust(8, b"\x5a"))))


def _tpdo(at: Place) -> Frame | None:
    """Returns a TPDO that the executor takes, with the present inputs."""
    wanted = at.judged.tpdos
    for index in (index for index in range(0x1800, 0x1820) if at.objects.has(index)):
        if (cob_id := at.objects.number(index, 1) & 0x8000_07FF) in wanted:
            mapped = at.objects.mapping(index)
            return Frame(
                cob_id, b"".join(at.objects.number(i, sub).to_bytes(bits // 8, "little") for i, sub, bits in mapped)
            )
    return None


@row("board")
def TPDOs_are_lost(at: Place) -> Fault | None:
    """Inputs are read in turn, and at once after an overrun; the world judges what is told of them."""
    flip = at.world.flip_of(at.name)
    if flip is None:
        return None
    asks = at.random.random() < 0.5

    def begin() -> None:
        at.bus.tpdos_to_lose = 99
        flip.begin()
        if asks:
            at.after(flip.told.least, at.tell(BusOverrun(at.bus.name)))

    def end() -> None:
        at.bus.tpdos_to_lose = 0
        flip.end()

    within = flip.told.within if asks else flip.told.within + at.sight.inputs_every(at.name) + 0.5
    return flip._replace(begin=begin, end=end, told=flip.told._replace(within=within, least=0.0))
