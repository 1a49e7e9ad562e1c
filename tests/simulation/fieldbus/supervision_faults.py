"""Faults of supervision, emergencies, and frames that no other node may send."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.events import FrameIgnored, FrameReceived
from tests.simulation.fieldbus.expected import Expected, Fault
from tests.simulation.fieldbus.fault_maker import Action, FaultMaker
from tests.simulation.judge.verdict import require

if TYPE_CHECKING:
    from tests.simulation.fieldbus.world import BoardWorld

AT_ONCE = 0.03  # [s] until a frame is told
STATES = {Command.STOP: "stopped", Command.PRE_OPERATIONAL: "pre-operational"}
STANDING = 0x1001


class SupervisionFaults(FaultMaker):
    def __init__(self, world: BoardWorld) -> None:
        super().__init__(world)
        self._guarded = world.watching.guarded(self._name)
        self._period = self._timing.heartbeat if self._guarded else self._board.objects.number(0x1017) / 1000

    def _silence_words(self) -> tuple[str, ...]:
        timeout = f"for {self._timing.heartbeat_timeout:g} s"
        return ("no answer to node guarding" if self._guarded else "no heartbeat", timeout)

    def _post(self, frame: Frame) -> Action:
        return lambda: self._site.tell(FrameReceived(self._bus.name, frame, self._world.agenda.now))

    def board_is_silent(self) -> Fault:
        timeout = self._timing.heartbeat_timeout
        expected = Expected(
            ("board-lost",),
            self._name,
            self._silence_words(),
            timeout + AT_ONCE,
            (self._name,),
            least=timeout - self._period - AT_ONCE,
        )

        def check() -> None:
            require(self._status().state == "lost", f"{self._status()} is lost")
            require(not self._world.master.back, f"{self._name} is silent, and told as back")

        return Fault(self._fault("silence"), self._fault("unsilence"), expected, check)

    def board_is_silent_for_a_moment(self) -> Fault | None:
        # Neither side notices. The heard heartbeats before and after the silence are up to a period each away from it.
        longest = max(self._period, self._timing.heartbeat)
        short = self._timing.heartbeat_timeout - 2 * longest - 2 * AT_ONCE
        if short <= 0 or self._timing.heartbeat_timeout < 0.2:
            return None

        def cause() -> None:
            self._site.boards.fault("silence", self._name)
            self._world.agenda.after(short, self._fault("unsilence"))

        return Fault(cause, self._nothing, Expected((), within=short + 0.2))

    def toggle_bit_stands_still(self) -> Fault | None:
        if not self._guarded:
            return None
        count = [0]

        def lose(bus: str, frame: Frame) -> str:
            if bus == self._bus.name and frame.id == 0x700 + self._judged.node:
                count[0] += 1
                return "lose" if count[0] % 2 else ""
            return ""

        def cause() -> None:
            self._site.intercept = lose

        def mend() -> None:
            self._site.intercept = lambda bus, frame: ""

        within = self._timing.heartbeat_timeout + 3 * self._period + AT_ONCE
        lost = Expected(("board-lost",), self._name, self._silence_words(), within, (self._name,))
        return Fault(cause, mend, lost)

    def board_restarts(self) -> Fault:
        boots = self._world.master.boots[list(self._world.wiring.boards).index(self._name)]

        def cause() -> None:
            self._site.boards.fault("power_cut", self._name)
            self._world.agenda.after(0.01, self._fault("power_on"))

        def check() -> None:
            now = self._world.master.boots[list(self._world.wiring.boards).index(self._name)]
            require(now == boots + 1, f"{self._name} has {now} boot-up messages, had {boots}")

        late = self._board.variant.boot_time
        codes = (
            ("board-rebooted",)
            if late < self._timing.heartbeat_timeout - self._period - AT_ONCE
            else ("board-rebooted", "board-lost")
        )
        also = codes if len(codes) > 1 else ("board-changed",)  # a read may come before the boot-up message
        words = ("has restarted",) if len(codes) == 1 else ()
        more = ("board-error", "emergency") if self._board.variant.errors else ()
        return Fault(
            cause,
            self._nothing,
            Expected(codes, self._name, words, 0.1 + late, (self._name,), also + more),
            check if len(codes) == 1 else self._nothing,
        )

    def board_leaves_operational(self) -> Fault:
        command = self._random.choice(list(STATES))
        expected = Expected(
            ("board-stopped",), self._name, ("without a command", STATES[command]), self._period + 0.12, (self._name,)
        )
        return Fault(lambda: self._site.order(self._name, command), self._nothing, expected)

    def two_boards_send_heartbeats(self) -> Fault | None:
        if self._guarded:
            return None
        running = [True]

        def beat() -> None:
            if running:
                self._bus.from_other(Frame(0x700 + self._judged.node, b"\x05"))
                self._world.agenda.after(self._period, beat)

        expected = Expected(
            ("duplicate-node",),
            self._name,
            ("two boards", self._name),
            35 * self._period + 0.2,
            (self._name,),
            least=5 * self._period,
        )

        def mend() -> None:
            running.clear()
            self._world.pass_time(21 * self._period)  # the beats of two windows are counted

        return Fault(beat, mend, expected)

    def some_heartbeats_are_doubled(self) -> Fault | None:
        if self._guarded:
            return None
        left = [3]

        def beat() -> None:
            if left[0]:
                left[0] -= 1
                self._bus.from_other(Frame(0x700 + self._judged.node, b"\x05"))
                self._world.agenda.after(3 * self._period, beat)

        return Fault(beat, self._nothing, Expected((), within=13 * self._period))

    def emergency(self) -> Fault:
        code, register = (
            self._random.choice([0x2310, 0x3320, 0x8F00, 0x5000, 0xFF01]),
            self._random.choice([1, 0x80, 0x81]),
        )
        size = self._random.choice([8, 8, 3, 2])
        data = (code.to_bytes(2, "little") + bytes([register, 0, 0, 0, 0, 0]))[:size]
        expected = Expected(("emergency",), self._name, ("it reports", f"({code:04X}h)"), AT_ONCE)

        def check() -> None:
            told = self._status().emergency
            require(told is not None and f"({code:04X}h)" in told, f"{self._name}: emergency {told} is told")
            self._post(Frame(0x80 + self._judged.node, self._random.choice([bytes(8), b"\x55" + bytes(7), bytes(2)])))()
            require(self._status().emergency is None, f"{self._name}: its emergency is over, and told")
            self._post(Frame(0x80 + self._judged.node, data))()  # once more: it is told once

        return Fault(self._post(Frame(0x80 + self._judged.node, data)), self._nothing, expected, check)

    def emergency_that_stands(self) -> Fault | None:
        """Bits of 1001h that an emergency has told are no further fault."""
        turn = self._world.watching.turn(self._bus.name, self._world.found)
        if turn > 6.0:
            return None
        objects, code = self._board.objects, 0x2310
        data = code.to_bytes(2, "little") + bytes([3, 0, 0, 0, 0, 0])

        def cause() -> None:
            objects.set_number(STANDING, 0, 3)
            self._post(Frame(0x80 + self._judged.node, data))()

        def check() -> None:
            self._world.pass_time(turn)

        expected = Expected(("emergency",), self._name, ("(2310h)",), AT_ONCE)
        return Fault(cause, lambda: objects.set_number(STANDING, 0, 0), expected, check)

    def foreign_master(self) -> Fault:
        rpdo = self._judged.rpdos[0].cob_id if self._judged.rpdos else None
        frames = {"SYNC": Frame(0x80), "NMT": Frame(0, b"\x01\x00"), "heartbeat": Frame(0x77F, b"\x05")}
        if rpdo is not None:
            frames["an RPDO"] = Frame(rpdo, bytes(8))
        what = self._random.choice(list(frames))
        frame = frames[what]
        expected = Expected(
            ("foreign-master",), self._bus.name, (what, f"frame {frame.id:03X}h", "only one may switch"), AT_ONCE
        )
        return Fault(self._post(frame), self._nothing, expected)

    def frames_that_nobody_understands(self) -> Fault:
        free = next(node for node in range(1, 127) if f"{self._bus.name}/{node}" not in self._world.looks)
        frames = [
            Frame(0x700 + free, b"\x05"),
            Frame(0x580 + free, bytes(8)),
            Frame(0x80 + self._judged.node, b"\x01"),  # a short emergency
            Frame(0x700 + self._judged.node, b""),
            Frame(0x700 + self._judged.node, b"\x05\x00"),
            Frame(0x700 + self._judged.node, b"" if self._guarded else b"\x33"),
            Frame(0x580 + self._judged.node, bytes(7)),
            Frame(0x100, b""),
            Frame(0x680 + self._judged.node, bytes(8)),
        ]
        drawn = self._random.sample(frames, 4)

        def ignored() -> int:
            return int(self._bus_status().ignored)

        def cause() -> None:
            before = ignored()
            for frame in drawn:
                self._post(frame)()
            bits = self._random.choice([47, 135])
            self._site.tell(FrameIgnored(self._bus.name, bits))  # an extended frame, for instance
            seen = ignored() - before
            require(seen == len(drawn) + 1, f"{seen} frames are told as ignored: {drawn}, and one of another kind")

        return Fault(cause, self._nothing, Expected((), within=0.2))

    def inputs_are_short(self) -> Fault | None:
        tpdo = self._tpdo()
        if tpdo is None:
            return None
        cob_id, data, _ = tpdo
        size = self._random.randrange(len(data))
        words = (f"in {size} bytes, not in {len(data)}",)
        expected = Expected(("wrong-length",), self._name, words, AT_ONCE)
        return Fault(self._post(Frame(cob_id, b"\xff" * size)), self._nothing, expected)

    def inputs_are_long(self) -> Fault | None:
        """The first bytes of a TPDO count; one warning tells of the others."""
        tpdo = self._tpdo()
        if tpdo is None or len(tpdo[1]) == 8 or self._board.variant.pads:
            return None
        cob_id, data, subs = tpdo
        more = self._random.randbytes(self._random.randint(1, 8 - len(data)))
        size, master = len(data) + len(more), self._world.master
        words = f"its inputs come in {size} bytes, though {len(data)} are mapped: only the first ones are used"
        lines = sum(wire.line for wire in self._judged.inputs if wire.bit // 8 + 1 in subs)

        def cause() -> None:
            ends = master.ends
            self._post(Frame(cob_id, bytes(byte ^ 0xFF for byte in data) + more))()
            require(master.ends == ends ^ lines, f"{self._name}: the first bytes of long inputs are not used")
            self._post(Frame(cob_id, data + more))()
            require(master.ends == ends, f"{self._name}: inputs are told as {master.ends:b}; they read {ends:b}")

        def check() -> None:
            told = [w.message for w in master.warnings() if (w.code, w.source) == ("board-limits", self._name)]
            require(len(told) == 1 and told[0].count(words) == 1, f"{self._name}: {told} is told, not once {words!r}")

        return Fault(cause, self._nothing, Expected((), within=0.2), check)

    def _tpdo(self) -> tuple[int, bytes, set[int]] | None:
        """Returns COB-ID and present data of a TPDO that the master takes, and the sub-indices of its inputs."""
        objects, wanted = self._board.objects, [pdo.cob_id for pdo in self._judged.tpdos]
        for index in (i for i in range(0x1800, 0x1820) if objects.has(i)):
            if objects.number(index, 1) & 0x8000_07FF in wanted:
                mapped = objects.mapping(index)
                data = b"".join(objects.number(i, sub).to_bytes(bits // 8, "little") for i, sub, bits in mapped)
                return objects.number(index, 1) & 0x7FF, data, {sub for i, sub, _ in mapped if i == 0x6000}
        return None
