"""The start of commits and releases; a release only switches lines off, and needs no ready board."""

from __future__ import annotations

from functools import partial

from drivers.canopen.boot.booting import Booting
from drivers.canopen.faults import Busy
from drivers.canopen.run.boards import Boards
from drivers.canopen.run.commit import Commit
from drivers.canopen.run.outputs import Key
from drivers.canopen.run.verification import Verification


class OutputSwitching:
    """Starts commits and releases of output lines, and gives them up.

    Times `now` are real times, times `time` stand still while the loop stalls [s].

    Args:
        boards: of the arm.
        booting: boots the boards; a release switches lines off during a boot, too.
        commit: sends the frames.
        verification: reads outputs back after the first commit.
    """

    def __init__(self, boards: Boards, booting: Booting, commit: Commit, verification: Verification) -> None:
        self._boards, self._booting, self._commit, self._verification = boards, booting, commit, verification
        self._releasing = 0, 0  # levels and lines of the last release

    def commit(self, outputs: int, now: float, time: float) -> None:
        """Switches all output lines to `outputs`: sends RPDOs, and one SYNC on each bus after them, see `Commit`.

        Nothing is sent if nothing changes. After a boot, the first commit ends when the outputs of boards without
        end-stops were read back.

        Raises:
            Busy: a commit is running, or a bus or a board is not ready.
            ValueError: `outputs` has a bit that is no line.
        """
        if self._commit.under_way:
            raise Busy("frames of the previous commit were not sent yet")
        if self._verification.blocking:
            raise Busy("the outputs of the previous commit are being read back")
        due = self._boards.outputs.due(outputs)
        if not due:
            self._commit.failed = None
            return
        self._begin(outputs, due, None, now, time)

    def release(self, outputs: int, now: float, time: float) -> None:
        """Switches the lines off that are not in `outputs`, and cancels a commit whose RPDOs wait.

        A release is also for boards that are not ready, for buses that were lost and send frames again, and for a boot
        under way. A release that waits for its echoes goes on.

        Raises:
            Busy: the SYNC of a commit was not sent yet, or a bus sends no frames.
        """
        boards = self._boards
        states, off = boards.released(~outputs)
        if not off or (self._commit.collecting and self._releasing == (states, off)):
            return
        self._commit.give_up("an output had to be switched off first")
        if self._commit.under_way:
            raise Busy("the SYNC of the previous commit was not sent yet")
        due = boards.outputs.due(states, off)
        booted = [i for bus in due for i in boards.left_out(bus, off)] if self._booting.under_way else []
        self._begin(states, due, off, now, time)
        self._releasing = states, off
        for station in (boards.stations[i] for i in booted):
            if station.board.heard:  # it was told to leave operational, in which its boot may have put it
                self._booting.rebooted(station, time)

    def give_up(self, why: str) -> None:
        """Gives up a commit whose SYNC was not handed out. Does nothing after that, or if it only switches lines off.

        Args:
            why: the reason for `Commit.failed`, as a sentence.
        """
        if self._releasing == (0, 0):
            self._commit.give_up(why)

    def give_up_release(self, why: str) -> None:
        """Gives up a release whose SYNC was not handed out, so that the next call sends it again."""
        if self._releasing != (0, 0):
            self._commit.give_up(why)
            self._releasing = 0, 0

    def _begin(self, states: int, due: dict[str, list[Key]], off: int | None, now: float, time: float) -> None:
        """Starts a commit; `off`: mask of lines if they only go off, else None."""
        if refusal := self._boards.refusal(off):
            raise Busy(refusal)
        frames = {bus: self._boards.frames_of(bus, keys, off) for bus, keys in due.items()}
        self._releasing, refuses = (0, 0), partial(self._boards.refusal, off)
        self._commit.begin(states, frames, refuses, now, time, together=off is None)
