"""Stages, which switch lines of several buses at one instant, and releases, which switch lines of one bus off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hyperbit.drivers.canopen.boards.board import Board
from hyperbit.drivers.canopen.boards.outputs import OutputLines
from hyperbit.drivers.canopen.faults import Busy
from hyperbit.drivers.canopen.pdo import union
from hyperbit.drivers.canopen.run.commit import BusCommit
from hyperbit.drivers.canopen.run.switch_off import switch_off
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, Frame
from hyperbit.drivers.canopen.wire.link import Link
from hyperbit.drivers.canopen.wiring import Timing

_RECENT = 0.01  # [s] from the begin of a stage, until nearly all of its frames are sent


class OutputSwitching:
    """Starts and gives up stages and releases of output lines.

    A SYNC is handed out only after all RPDOs were sent. So no SYNC waits in a queue when a bus fails, and frames that
    the kernel still holds switch nothing when the bus comes back. Each bus has its own release; no other bus delays it.
    A release also switches lines off during a boot, then by SDO. Times `now` are real times, times `time` stand still
    while the loop stalls [s].
    """

    def __init__(
        self, boards: Sequence[Board], links: Mapping[str, Link], outputs: OutputLines, timing: Timing
    ) -> None:
        self.failed: str | None = None  # why the last stage has failed, as a sentence; None after a success
        self._switched: list[tuple[int, float]] = []
        self.commits = {name: BusCommit(link, outputs, self._switched) for name, link in links.items()}
        self._boards, self._outputs = boards, outputs
        # A commit that takes longer is cancelled, since its SYNC would be too late [s].
        self._longest = timing.heartbeat_timeout / 2
        self._told_within = 3 * timing.heartbeat  # [s], in which a board tells its NMT state
        self._stage: list[BusCommit] = []
        self._releases: dict[str, int] = {}  # by bus: mask of the lines that its last release switches off
        self._now = 0.0  # at the last tick [s]

    @property
    def under_way(self) -> bool:
        """Whether a stage is under way, or a frame of an abandoned one."""
        return any(commit.under_way for commit in self._stage)

    @property
    def collecting(self) -> bool:
        """Whether a commit waits for the echo of RPDOs; only the last of them changes anything."""
        return any(commit.collecting for commit in self.commits.values())

    @property
    def unknown(self) -> bool:
        """Whether a frame that switches was handed out, and its sending is not confirmed."""
        return any(commit.unknown for commit in self.commits.values())

    @property
    def leaving(self) -> int:
        """Mask of the lines that frames under way will switch: SYNCs, and RPDOs of boards without SYNC."""
        return union(commit.leaving for commit in self.commits.values())

    def drain(self) -> list[tuple[int, float]]:
        """Returns the switches since the last call: mask of lines, and real time of the SYNC or write [s]."""
        switched = list(self._switched)
        self._switched.clear()
        return switched

    def commit(self, outputs: int, now: float, time: float) -> None:
        """Switches all output lines: sends RPDOs, then one SYNC on each bus with a change."""
        due = self._outputs.due(outputs)
        if self.under_way:
            raise Busy("frames of the previous commit were not sent yet")
        self._stage, self.failed = [], None
        if not due:
            return
        refusals = (self.commits[bus].refusal(keys) for bus, keys in due.items())
        if refusal := self._refusal(None) or next(filter(None, refusals), None):
            raise Busy(refusal)
        self._stage = [self.commits[bus] for bus in due]
        for bus, keys in due.items():
            self._releases.pop(bus, None)
            self.commits[bus].begin(outputs, [], keys, now, time)
        self._advance(now, time)

    def release(self, off: int, now: float, time: float) -> None:
        """Switches lines off; on their buses it gives a stage up whose RPDOs wait.

        A release also works for boards that are not ready, for buses that send frames again after a loss, and during a
        boot. A release that cannot begin now begins at a later call. A release that waits for its echoes continues. It
        omits boards that have restarted: their outputs are off. No frame leaves on a bus with an output of unknown
        level: there each board that answers gets the lines off by SDO, and keeps its other outputs.
        """
        commanded, doubtful = self._outputs.commanded, self._outputs.doubtful
        alive = union(board.layout.output_lines for board in self._boards if not board.restarted)
        off &= (commanded | doubtful) & alive
        unknown = {board.layout.bus for board in self._boards if not board.remembered}
        for bus in self.commits:
            here = self._outputs.lines_of(bus)
            if off & here and (bus in unknown or doubtful & here & ~off):
                self._switch_off(bus, off & here, time)
            elif off & here:
                self._release(bus, commanded & ~off, off & here, now, time)
        self._advance(now, time)

    def give_up(self, why: str, commits: Sequence[BusCommit] | None = None) -> None:
        """Gives up the stage, or a release, if its SYNC was not handed out; `why` is a sentence."""
        commits = self._stage if commits is None else commits
        if any(commit.collecting for commit in commits):
            for commit in commits:
                commit.give_up(why)
            self._end_failed()

    def forget(self) -> None:
        """Cancels everything; the caller then reads the outputs back."""
        for commit in self.commits.values():
            commit.lost()
        self._stage, self._releases, self.failed = [], {}, None

    def sent(self, bus: str, frame: Frame, now: float, time: float) -> None:
        if (commit := self.commits[bus]).under_way:
            commit.sent(frame, now)
            self._advance(now, time)

    def send_failed(self, bus: str, frame: Frame, why: str) -> None:
        self.commits[bus].send_failed(frame, why)
        self._end_failed()

    def bus_lost(self, bus: str) -> None:
        self.commits[bus].lost()
        self._end_failed()

    def tick(self, now: float, time: float) -> None:
        self._now = now
        for commit in self.commits.values():
            if commit.under_way:
                commit.tick(now)
        self._advance(now, time)

    def _refusal(self, off: int | None) -> str | None:
        """Returns why nothing may be switched now, or None; `off`: lines of a release, None: a stage.

        A lost board may still receive a release. So a release only needs a bus that sends frames, armed or not.
        """
        if off is not None:
            lost = [b.link for b in self._boards if b.layout.output_lines & off and not b.link.usable]
        else:
            lost = [commit.link for commit in self.commits.values() if not commit.link.armed]
        if lost:
            return f"{lost[0].name} is {lost[0].state} or was lost: nothing is sent until its boards are booted"
        for board in self._boards if off is None else ():
            if not board.ready:
                return f"board {board.name} is not ready: nothing is sent until it is booted"
        return None

    def _release(self, bus: str, states: int, off: int, now: float, time: float) -> None:
        commit = self.commits[bus]
        if commit.collecting and self._releases.get(bus) == off and commit.states == states:
            return
        if commit in self._stage:
            if self._ends(commit, off, now):
                return
            self.give_up("an output had to be switched off first")
        commit.give_up("it is replaced")
        keys = self._outputs.due(states, off)[bus]
        if self._refusal(off) or commit.refusal(keys):
            return
        # A SYNC would also switch a lost board that is operational and has latched a frame. So a lost board leaves
        # operational first, unless it has lines that go off now, or pulses that end later: it gets its frame.
        here = [board for board in self._boards if board.link is commit.link]
        needed = off | states & self._outputs.pulsed
        left_out = {b.index: b.layout.node for b in here if not b.ready and not b.layout.output_lines & needed}
        orders = [cia301.command(Command.PRE_OPERATIONAL, node) for node in left_out.values()]
        keys = [key for key in keys if not self._outputs.frames[key].boards <= left_out.keys()]
        self._stage = [other for other in self._stage if other is not commit]
        self._releases[bus] = off
        commit.begin(states, orders, keys, now, time)

    def _switch_off(self, bus: str, off: int, time: float) -> None:
        """Switches lines off by SDO, on the boards of a bus that have nothing else to do."""
        self.give_up("an output had to be switched off first")
        self.commits[bus].give_up("it is replaced")
        for board in self._boards:
            here = board.layout.output_lines & off
            if here and board.layout.bus == bus and board.heard and board.link.usable and not board.runner.running:
                procedure = switch_off(board, self._outputs, here, self._told_within, self._written_off)
                board.runner.start(procedure, None, time)

    def _written_off(self, lines: int) -> None:
        if lines:
            self._switched.append((lines, self._now))

    def _ends(self, commit: BusCommit, off: int, now: float) -> bool:
        """Returns whether a stage that has just begun switches the lines off without waiting for another bus.

        A release in its place would wait for the frames of the stage, and the next call may come a period later.
        """
        on = commit.states | self._outputs.doubtful
        alone = not any(other.waiting for other in self._stage if other is not commit)
        return commit.collecting and alone and not off & on and now - commit.began < _RECENT

    def _advance(self, now: float, time: float) -> None:
        """Hands out the SYNCs of stage and releases whose RPDOs were sent, and ends those that take too long."""
        releases = [([self.commits[bus]], off) for bus, off in self._releases.items()]
        for commits, off in [(self._stage, None), *releases]:
            if not any(commit.collecting for commit in commits):
                continue
            waiting = [commit.bus for commit in commits if commit.waiting]
            if now - commits[0].began > self._longest:
                late = f"frames on {', '.join(waiting)} were not sent" if waiting else "the executor was halted"
                self.give_up(f"{late} for {self._longest:g} s", commits)
            elif waiting:
                continue
            elif refusal := self._refusal(off):
                self.give_up(refusal, commits)
            else:
                for commit in commits:
                    commit.sync(time)

    def _end_failed(self) -> None:
        """Gives a stage up on all its buses if one of them has failed."""
        why = next((commit.failed for commit in self._stage if commit.failed), None)
        if why is not None:
            self.failed = self.failed or why
            for commit in self._stage:
                commit.give_up(why)
