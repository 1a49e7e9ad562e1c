"""Commands whose frames do not leave, or do not reach a board; and releases beside a lost board."""

from __future__ import annotations

from typing import Any

from hyperbit.drivers.canopen.faults import Busy
from tests.simulation.fieldbus.command_maker import AT_ONCE, COMMITTED, CommandMaker
from tests.simulation.fieldbus.expected import Expected, Fault
from tests.simulation.fieldbus.use import moves
from tests.simulation.judge.verdict import require

READ_BACK = 1.3  # [s] from a switch until outputs are read
SHORT_PULSES = 3
TPDOS = range(0x180, 0x580, 0x100)


class UnsentFaults(CommandMaker):
    def RPDO_is_not_sent(self) -> Fault | None:
        if not (self._fit and self._waits()):
            return None
        buses = [bus for bus in self._site.buses.values() if self._world.switching.lines_on(bus.name) & self._changed]
        bus = self._random.choice(buses)

        def cause() -> None:
            bus.room = 0
            self._commit(self._states)
            bus.room = None

        def check() -> None:
            self._unswitched("was not sent")
            self._world.switching.booted()

        return Fault(cause, lambda: None, Expected((), within=AT_ONCE, calm=False), check)

    def frames_stay_in_the_controller(self) -> Fault | None:
        if not (self._fit and self._waits()):
            return None
        buses = [bus for bus in self._site.buses.values() if self._world.switching.lines_on(bus.name) & self._changed]
        bus = self._random.choice(buses)
        timing = self._world.drawn.timing

        def cause() -> None:
            bus.stuck = True
            self._commit(self._states)

        def check() -> None:
            self._unswitched("were not sent for", *([f"{bus.name} was lost"] if lost_first else []))

        late = timing.heartbeat_timeout / 2 + 0.03
        if late + AT_ONCE > timing.heartbeat_timeout - timing.heartbeat:
            return None  # the boards would lose the master before
        lost_first = 0.8 * (timing.heartbeat_timeout - timing.heartbeat) <= late - 0.01
        lost = tuple(n for n, b in self._world.wiring.boards.items() if b.bus == bus.name)
        also = ("bus-busy",)
        return Fault(cause, bus.restore, Expected((), within=late, lost=lost, also=also, calm=False), check)

    def bus_is_lost_with_a_SYNC(self) -> Fault | None:
        if not (self._fit and self._waits()):
            return None
        world, master = self._world, self._world.master
        buses = [bus for bus in self._site.buses.values() if world.switching.lines_on(bus.name) & self._changed]
        bus = self._random.choice(buses)
        doubtful = world.switching.lines_on(bus.name) & self._changed
        lost = tuple(n for n, b in world.wiring.boards.items() if b.bus == bus.name)

        def cause() -> None:
            keep = self._site.hands_out

            def look(name: str, frame: Any) -> None:
                keep(name, frame)
                if name == bus.name and frame.id == 0x80:
                    world.agenda.at(world.agenda.now, bus.go_down)

            self._site.hands_out = look
            self._commit(self._states)
            world.wait(lambda: bus.state == "down", 0.2, "down")
            self._site.hands_out = keep

        def check() -> None:
            failed = master.commit_failed
            require(failed is not None and "was lost while its SYNC" in failed, f"the failure is {failed!r}")
            require(master.doubtful == doubtful, f"{master.doubtful:b} are doubtful, {doubtful:b} may have switched")
            require(not master.outputs_known, "outputs are known, and a SYNC was lost")
            world.wait(lambda: not master.committing, 0.6, "over on the other bus")
            why = self._refused(self._states, Busy)
            require(bus.name in why, f"a command on a lost bus is refused by {why!r}")

        expected = Expected(("bus-down",), bus.name, (), AT_ONCE, lost, calm=False)
        return Fault(cause, bus.restore, expected, check)

    def command_without_a_board(self) -> Fault | None:
        """A command is refused while a board is lost; lines of other boards can still be switched off."""
        world, master = self._world, self._world.master
        name = self._random.choice(list(world.looks))
        timing = world.drawn.timing

        def check() -> None:
            why = self._refused(self._before ^ 1, Busy)
            require(name in why and "not ready" in why, f"a command without {name} is refused by {why!r}")
            others = [b for n, b in world.wiring.boards.items() if n != name and b.lines & master.outputs]
            if not others or not self._waits():
                return
            off = others[0].lines & master.outputs
            before = {n: look.pins() for n, look in world.looks.items()}
            self._site.call(lambda m: m.commit(~off & world.wiring.lines, world.agenda.now, release=True))
            world.wait(lambda: not moves(master), 0.6 + world.watching.slack, "released")
            now = world.switching.driven()
            require(not now & off, f"{off:b} are switched off without {name}, the pins are {now:b}")
            others_changed = [
                n for n, look in world.looks.items() if n not in (name, others[0].name) and look.pins() != before[n]
            ]
            require(not others_changed, f"the pins of {others_changed} have changed, {off:b} are switched off")

        lost = Expected(("board-lost",), name, (), timing.heartbeat_timeout + 0.05, (name,))
        return Fault(
            lambda: self._site.boards.fault("silence", name),
            lambda: self._site.boards.fault("unsilence", name),
            lost,
            check,
        )

    def release_beside_a_board_that_only_hears(self) -> Fault | None:
        """A board that is not heard has latched a command that was given up: no SYNC of a release switches it."""
        world, name = self._world, self._name
        others = [b for n, b in world.wiring.boards.items() if n != name and b.bus == self._judged.bus and b.lines]
        latched = self._judged.lines & self._changed
        if not (self._fit and self._waits() and latched and others) or world.drawn.wiring.shared_rpdo:
            return None
        on = [b for b in others if b.lines & self._before]
        if not on:
            return None
        off = on[0].lines & self._before

        def lose(bus: str, frame: Any) -> str:
            sends = frame.id & 0x7F == self._judged.node and (frame.id & 0x780) in (0x580, 0x700, 0x80, *TPDOS)
            return "lose" if bus == self._judged.bus and sends and not frame.id >> 11 else ""

        def cause() -> None:
            self._commit(self._states)
            world.master.give_up("the test says so")
            world.pass_time(AT_ONCE)
            self._site.intercept = lose

        def check() -> None:
            before = world.looks[name].pins()
            self._site.call(lambda m: m.commit(~off & world.wiring.lines, world.agenda.now, release=True))
            world.wait(lambda: not moves(world.master), COMMITTED + world.watching.slack, "released")
            pins, driven = world.looks[name].pins(), world.switching.driven()
            require(pins == before, f"{name}: pins {before:b} become {pins:b} by a release of {off:b}")
            require(not driven & off, f"{off:b} are switched off beside {name}, the pins are {driven:b}")

        timeout = AT_ONCE + self._timing.heartbeat_timeout + AT_ONCE
        expected = Expected(("board-lost",), name, (), timeout, (name,))
        return Fault(cause, self._intercept_nothing, expected, check)

    def pulses_are_too_short(self) -> Fault | None:
        """Pulses end before their outputs are read: each is missed, and the third in a row is a fault."""
        world, master = self._world, self._world.master
        blind = [w.line for w in self._judged.outputs if w.line & world.wiring.pulsed & self._judged.unsensed]
        if not blind or self._before & world.wiring.pulsed or self._board.variant.answer_delay or not self._waits():
            return None
        line = self._random.choice(blind)

        def pulse() -> None:
            self._commit(world.switching.states | line)
            world.wait(lambda: master.outputs & line, 0.1, "on")
            self._site.call(lambda m: m.commit(~line & world.wiring.lines, world.agenda.now, release=True))
            world.wait(lambda: master.drain_missed() & line, COMMITTED, f"{line:b} was on, not read back, and missed")
            world.wait(lambda: not moves(master), COMMITTED, "released")
            world.pass_time(READ_BACK)
            master.drain_switched()

        def cause() -> None:
            before = self._status().unverified
            for k in range(SHORT_PULSES):
                pulse()
                now = self._status().unverified
                require(
                    now == before + k + 1, f"{self._name}: {now} are unverified, were {before}, {k + 1} short pulses"
                )

        words = ("before they were read back", "verify: false")
        expected = Expected(("not-verified",), self._name, words, AT_ONCE, (self._name,))
        return Fault(cause, self._nothing, expected, lambda: world.switching.forget(world.switching.driven()))
