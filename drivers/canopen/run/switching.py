"""Stages, which switch lines of several buses at one instant, and releases, which switch lines of one bus off."""

from __future__ import annotations

from dataclasses import dataclass

from hyperbit.drivers.canopen.boot.booting import Booting
from hyperbit.drivers.canopen.faults import Busy
from hyperbit.drivers.canopen.pdo import union
from hyperbit.drivers.canopen.run.boards import Boards
from hyperbit.drivers.canopen.run.commit import BusCommit
from hyperbit.drivers.canopen.wire.cia301 import Frame

_RECENT = 0.01  # [s] from the begin of a stage, within which nearly all of its frames are sent


@dataclass
class Switch:
    """A stage or a release.

    Attributes:
        commits: those of its buses; no SYNC is handed out before the RPDOs of all of them were sent.
        off: mask of the lines that a release switches off; None: it is a stage.
    """

    commits: list[BusCommit]
    off: int | None = None

    @property
    def collecting(self) -> bool:
        """Whether it waits for RPDOs."""
        return any(commit.collecting for commit in self.commits)

    @property
    def under_way(self) -> bool:
        """Whether it may still switch something."""
        return any(commit.under_way for commit in self.commits)


class OutputSwitching:
    """Starts stages and releases of output lines, and gives them up.

    A SYNC is handed out only after all RPDOs were sent. So none waits in a queue when a bus fails, and the frames that
    the kernel still holds switch nothing when the bus comes back. Each bus has its own release, which no other bus
    delays.
    Times `now` are real times, times `time` stand still while the loop stalls [s].

    Attributes:
        failed: why the last stage has failed, as a sentence; None after a success.
        switched: masks of switched lines, each with the real time of its SYNC [s].

    Args:
        boards: of the arm.
        booting: boots the boards; a release switches lines off during a boot, too.
        longest: a commit that takes longer is cancelled, since its SYNC would be too late [s, real time].
    """

    def __init__(self, boards: Boards, booting: Booting, longest: float) -> None:
        self.failed: str | None = None
        self.switched: list[tuple[int, float]] = []
        self._boards, self._booting, self._longest = boards, booting, longest
        self._commits = {n: BusCommit(link, boards.outputs, self.switched) for n, link in boards.links.items()}
        self._stage = Switch([])
        self._releases: dict[str, Switch] = {}

    @property
    def under_way(self) -> bool:
        """Whether a stage is under way, or a frame of one that was given up."""
        return self._stage.under_way

    def busy(self, bus: str) -> bool:
        """Returns whether frames on their way may still switch something on a bus."""
        return self._commits[bus].under_way

    @property
    def collecting(self) -> bool:
        """Whether RPDOs are awaited."""
        return any(commit.collecting for commit in self._commits.values())

    @property
    def unknown(self) -> bool:
        """Whether a frame that switches was handed out, and may or may not be sent."""
        return any(commit.unknown for commit in self._commits.values())

    @property
    def leaving(self) -> int:
        """Mask of the lines that frames already handed out will switch, whatever is commanded now."""
        return union(commit.leaving for commit in self._commits.values())

    def commit(self, outputs: int, now: float, time: float) -> None:
        """Switches all output lines to `outputs`: sends RPDOs, and one SYNC on each bus after all of them.

        Nothing is sent if nothing changes.

        Raises:
            Busy: frames of a bus were not sent yet, or a bus or a board is not ready.
            ValueError: `outputs` has a bit that is no line.
        """
        due = self._boards.outputs.due(outputs)
        if self._stage.under_way:
            raise Busy("frames of the previous commit were not sent yet")
        self.failed = None
        if not due:
            return
        refusals = (self._commits[bus].refusal(keys) for bus, keys in due.items())
        if refusal := self._boards.refusal() or next(filter(None, refusals), None):
            raise Busy(refusal)
        self._stage = Switch([self._commits[bus] for bus in due])
        for bus, keys in due.items():
            self._releases.pop(bus, None)
            self._commits[bus].begin(outputs, self._boards.frames_of(bus, keys, None), now, time)
        self._advance(now, time)

    def release(self, outputs: int, now: float, time: float) -> None:
        """Switches the lines off that are not in `outputs`; on their buses it gives a stage up whose RPDOs wait.

        A release is also for boards that are not ready, for buses that were lost and send frames again, and for a boot
        under way. One that cannot begin now, begins at a later call. One that waits for its echoes goes on.
        """
        states, off = self._boards.released(~outputs)
        for bus in self._commits:
            if here := off & self._boards.outputs.lines_of(bus):
                self._release(bus, states, here, now, time)
        self._advance(now, time)

    def give_up(self, why: str) -> None:
        """Gives up a stage whose SYNC was not handed out; `why` is the reason for `failed`, as a sentence."""
        self._give_up(self._stage, why)

    def forget(self) -> None:
        """Cancels everything; the caller reads the outputs back."""
        for commit in self._commits.values():
            commit.lost()
        self._stage, self._releases, self.failed = Switch([]), {}, None

    def sent(self, bus: str, frame: Frame, now: float, time: float) -> None:
        """Records that a frame of the master was sent."""
        if (commit := self._commits[bus]).under_way:
            commit.sent(frame, now)
            self._advance(now, time)

    def send_failed(self, bus: str, frame: Frame, why: str) -> None:
        """Records that a frame of the master could not be sent."""
        self._commits[bus].send_failed(frame, why)
        self._end_failed()

    def bus_lost(self, bus: str) -> None:
        """Records the loss of a bus."""
        self._commits[bus].lost()
        self._end_failed()

    def tick(self, now: float, time: float) -> None:
        """Call every period."""
        for commit in self._commits.values():
            if commit.under_way:
                commit.tick(now)
        self._advance(now, time)

    def _release(self, bus: str, states: int, off: int, now: float, time: float) -> None:
        commit, last = self._commits[bus], self._releases.get(bus)
        if last is not None and last.collecting and (last.off, commit.states) == (off, states):
            return
        if commit in self._stage.commits:
            if self._ends(commit, off, now):
                return
            self._give_up(self._stage, "an output had to be switched off first")
        commit.give_up("it is replaced")
        keys = self._boards.outputs.due(states, off)[bus]
        if self._boards.refusal(off) or commit.refusal(keys):
            return
        booted = self._boards.left_out(bus, off) if self._booting.under_way else ()
        self._stage.commits = [other for other in self._stage.commits if other is not commit]
        self._releases[bus] = Switch([commit], off)
        commit.begin(states, self._boards.frames_of(bus, keys, off), now, time)
        for station in (self._boards.stations[i] for i in sorted(booted)):
            if station.board.heard:  # it was told to leave operational, in which its boot may have put it
                self._booting.rebooted(station, time)

    def _ends(self, commit: BusCommit, off: int, now: float) -> bool:
        """Returns whether a stage that has just begun switches the lines off, and waits for no other bus.

        A release in its place would wait for the frames of the stage, and the next call may come a period later.
        """
        stage, on = self._stage, commit.states | self._boards.outputs.doubtful
        alone = not any(other.waiting for other in stage.commits if other is not commit)
        return commit.collecting and alone and not off & on and now - commit.began < _RECENT

    def _advance(self, now: float, time: float) -> None:
        """Hands out the SYNCs of stage and releases whose RPDOs were sent, and ends those that take too long."""
        for switch in (self._stage, *self._releases.values()):
            if not switch.collecting:
                continue
            waiting = [commit.bus for commit in switch.commits if commit.waiting]
            if now - switch.commits[0].began > self._longest:
                late = f"frames on {', '.join(waiting)} were not sent" if waiting else "the executor was halted"
                self._give_up(switch, f"{late} for {self._longest:g} s")
            elif waiting:
                continue
            elif refusal := self._boards.refusal(switch.off):
                self._give_up(switch, refusal)
            else:
                for commit in switch.commits:
                    commit.sync(time)

    def _give_up(self, switch: Switch, why: str) -> None:
        if switch.collecting:
            for commit in switch.commits:
                commit.give_up(why)
            self._end_failed()

    def _end_failed(self) -> None:
        """Gives a stage up on all its buses if one of them has failed."""
        why = next((commit.failed for commit in self._stage.commits if commit.failed), None)
        if why is not None:
            self.failed = self.failed or why
            for commit in self._stage.commits:
                commit.give_up(why)
