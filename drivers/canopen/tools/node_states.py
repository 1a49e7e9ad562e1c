"""NMT states of the nodes of one bus, from heartbeats and from answers to remote frames (CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

from drivers.canopen.sdo.procedure import Procedure, Wait
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import STATES, Frame, State
from drivers.canopen.wire.link import Link, Outgoing
from drivers.canopen.wiring import MASTER

_STATE = 0x7F  # bits of the answer to a remote frame; the bit above alternates
_ANSWER = 0.3  # [s] for the answer to a remote frame


class NodeStates:
    """The NMT states of the nodes of one bus.

    A stopped board answers no SDO. A board with heartbeats tells its state by itself, and a board with node guarding
    answers a remote frame.

    Attributes:
        states: last NMT state by node id.

    Args:
        link: the bus.
    """

    def __init__(self, link: Link) -> None:
        self.states: dict[int, State] = {}
        self._link = link
        self._polls: list[Outgoing] = []  # remote frames to send at the next tick

    @property
    def master_heard(self) -> bool:
        """Whether a master, such as an executor, sends its heartbeat."""
        return MASTER in self.states

    def hear(self, frame: Frame) -> None:
        """Takes a frame from the bus."""
        function, node = cia301.split(frame.id)
        if function == cia301.HEARTBEAT and len(frame.data) == 1:
            state = STATES.get(frame.data[0] & _STATE)
            if state is not None and node:
                self.states[node] = state

    def learn(self, node: int) -> Procedure:
        """Polls a node by a remote frame, unless it was heard already; waits 0.3 s for the answer.

        Call this only for a node that answers no SDO: the remote frame starts the node guarding of an operational node.
        """
        if node in self.states:
            return
        poll = Outgoing(Frame(cia301.REMOTE | cia301.HEARTBEAT + node))
        self._polls.append(poll)
        yield Wait(lambda: node in self.states, _ANSWER)
        poll.cancelled = True

    def tick(self, now: float) -> None:
        """Sends the remote frames that wait."""
        polls, self._polls = self._polls, []
        for poll in polls:
            self._link.queue(poll, now)


def stopped(board: str) -> str:
    """Returns the sentence for a stopped board; `board` is its name, e.g. "can0/5"."""
    return (
        f"board {board} is stopped, as after the end of an executor with on_loss: contract; it answers no SDO: start"
        f" the executor, or reset the board: hyperbit board ARM.yaml {board} reset"
    )
