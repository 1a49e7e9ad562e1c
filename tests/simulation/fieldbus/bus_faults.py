"""Faults of buses, pauses of the executor, and lost TPDOs."""

from __future__ import annotations

from typing import Any

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusOverrun
from tests.simulation.fieldbus.expected import Expected, Fault
from tests.simulation.fieldbus.fault_maker import FaultMaker
from tests.simulation.fieldbus.site import LATE, READS_INPUTS
from tests.simulation.judge.verdict import require

AT_ONCE = 0.03  # [s] until a change of a bus is told


class BusFaults(FaultMaker):
    def bus_is_down(self) -> Fault:
        return self._bus_fault(self._bus.go_down, "bus-down", ("is down",))

    def bus_is_off(self) -> Fault:
        return self._bus_fault(self._bus.go_off, "bus-off", ("bus-off",))

    def _bus_fault(self, cause: Any, code: str, words: tuple[str, ...]) -> Fault:
        expected = Expected((code,), self._bus.name, words, AT_ONCE, self._here, calm=False)

        def check() -> None:
            require(not self._world.master.back, f"{self._bus.name} is told as back")
            state = self._bus_status().state
            require(state == code.replace("bus-down", "down"), f"{state} is told for {code}")

        return Fault(cause, self._bus.restore, expected, check)

    def bus_is_stuck(self) -> Fault:
        def cause() -> None:
            self._bus.acknowledged = False

        within = self._timing.heartbeat_timeout + self._timing.heartbeat + 0.1
        expected = Expected(
            ("bus-busy",), self._bus.name, ("no frame was sent",), within, self._here, also=("board-lost",), calm=False
        )
        return Fault(cause, self._bus.restore, expected)

    def queue_is_full(self) -> Fault:
        def cause() -> None:
            self._bus.capacity = 0

        within = self._timing.heartbeat_timeout + self._timing.heartbeat + 0.1
        expected = Expected(
            ("bus-busy",), self._bus.name, ("no frame was sent",), within, self._here, also=("board-lost",), calm=False
        )
        return Fault(cause, self._bus.restore, expected)

    def queue_is_full_for_a_moment(self) -> Fault | None:
        """The next frame cannot be sent, and is sent again."""
        if self._timing.heartbeat_timeout < 3 * self._timing.heartbeat or self._timing.heartbeat < 0.05:
            return None

        def cause() -> None:
            self._bus.room = 0
            self._world.agenda.after(self._timing.heartbeat + 0.005, lambda: setattr(self._bus, "room", None))

        return Fault(cause, self._bus.restore, Expected((), within=3 * self._timing.heartbeat, calm=False))

    def bus_is_passive(self) -> Fault:
        def check() -> None:
            told = [w for w in self._world.master.warnings() if w.code == "bus-passive"]
            right = len(told) == 1 and told[0].source == self._bus.name and "128 transmit" in told[0].message
            require(right, f"{self._bus.name} is error-passive, warned is {told}")

        def mend() -> None:
            self._bus.restore()
            told = [w for w in self._world.master.warnings() if w.code == "bus-passive"]
            require(not told, f"{self._bus.name} is active, warned is {told}")

        return Fault(self._bus.warn, mend, Expected((), within=0.05), check)

    def executor_stands_still(self) -> Fault:
        long = self._timing.heartbeat_timeout * self._random.choice([1.3, 2.0])
        found: list[Any] = []

        def cause() -> None:
            self._stall(long)
            found.append(self._world.master.find_pause(self._world.agenda.now))
            again = self._world.master.find_pause(self._world.agenda.now)
            require(again is None, f"a pause is told twice: {again}")
            self._site.go_on()

        def check() -> None:
            fault = found[0]
            told = [f"{long + 0.01 * k:.2f} s" for k in range(3)]  # since the last tick
            right = fault is not None and fault.code == "halted" and any(words in fault.message for words in told)
            require(right, f"a pause of {long:g} s is told as {fault}")

        everything = tuple(self._world.looks)
        also = ("board-stopped", "board-lost", "emergency", "board-error", "bus-busy")
        expected = Expected((), within=0.05, lost=everything, also=also, calm=False)
        return Fault(cause, self._nothing, expected, check)

    def executor_stalls_for_a_moment(self) -> Fault:
        short = 0.7 * (self._timing.heartbeat_timeout - self._timing.heartbeat)

        def cause() -> None:
            self._stall(short)
            found = self._world.master.find_pause(self._world.agenda.now)
            require(found is None, f"a pause of {short:g} s is told as {found}")
            self._site.go_on()

        return Fault(cause, self._nothing, Expected((), within=0.2, calm=False))

    def _stall(self, seconds: float) -> None:
        over: list[bool] = []
        self._site.stalled = True
        self._world.agenda.after(seconds, lambda: over.append(True))
        self._world.wait(lambda: over, 2 * seconds, "over")

    def TPDO_is_lost(self) -> Fault | None:
        locks = [
            lock
            for lock in self._world.drawn.wiring.interlocks
            if (lock.bus, lock.node) == (self._bus.name, self._judged.node)
        ]
        if not locks:
            return None

        def cause() -> None:
            self._bus.tpdos_to_lose = 99
            self._site.boards.fault("open", locks[0].name)

        def check() -> None:
            self._world.watching.now = self._world.agenda.now
            ends = sum(b.read(self._world.looks[b.name].inputs()) for b in self._world.wiring.boards.values())
            require(self._world.master.ends == ends, f"inputs {self._world.master.ends:b} are told; they are {ends:b}")

        def mend() -> None:
            self._bus.tpdos_to_lose = 0
            self._site.boards.fault("close", locks[0].name)

        within = 2.0 + self._world.watching.slack
        return Fault(cause, mend, Expected((), within=within), check)

    def answer_of_inputs_is_late(self) -> Fault | None:
        """An input changes after the board has read it for an answer, which comes later than the TPDO."""
        if not self._judged.sensed:
            return None
        world, late = self._world, list[str]()

        def intercept(bus: str, frame: Frame) -> str:
            answers = f"{bus}/{frame.id & 0x7F}" == self._name and frame.id & ~0x7F == 0x580
            if late or not answers or frame.data[1:3] != READS_INPUTS or not world.flip_input(self._name):
                return ""
            late.append("late")
            world.agenda.after(LATE + 0.005, judge)
            return "late"

        def judge() -> None:
            ends = sum(b.read(world.looks[b.name].inputs()) for b in world.wiring.boards.values())
            require(world.master.ends == ends, f"inputs {world.master.ends:b} are told after a late answer: {ends:b}")

        def mend() -> None:
            self._intercept_nothing()
            world.undo_flips()

        within = world.watching.inputs_every(self._name) + 0.4 + world.watching.slack
        return Fault(lambda: setattr(self._site, "intercept", intercept), mend, Expected((), within=within))

    def overrun(self) -> Fault | None:
        fault = self.TPDO_is_lost()
        if fault is None:
            return None

        def cause() -> None:
            fault.cause()
            if self._random.random() < 0.5:
                self._site.tell(BusOverrun(self._bus.name))
            else:
                index = list(self._world.wiring.boards).index(self._name)
                self._site.call(lambda m: m.question(index, self._world.agenda.now))
                require(self._world.master.questioning(index), f"{self._name} is asked, and no question is told")

        within = 0.05 + self._world.watching.slack
        return fault._replace(cause=cause, expected=fault.expected._replace(within=within))
