"""The planner as the gateway uses it."""

import itertools
import time
from collections.abc import Callable, Collection

from controller.config import Arm
from controller.planning.core.events import (
    CancelMessage,
    Key,
    Message,
    Payload,
    Quit,
    Request,
    SetpointArrived,
    TipArrived,
    Unsent,
)
from controller.planning.description import density, description, drawing, file
from controller.planning.shell.link import ExecutorLink
from controller.planning.shell.loop import Loop, OnReply
from controller.planning.shell.mailboxes import Receive
from controller.planning.shell.requests import RequestDecoder
from controller.program import Cancel, Halt
from controller.workspace.densities import Densities

CANCELED = "canceled; the arm holds"
LAST_RESULTS = 1.5  # [s] for the core and the executor to end the running goal


class Planner:
    """Passes requests to the core. For any thread; all methods but `end_goals` and `close` return at once.

    Args:
        arm: with wiring.
        densities: of the arm reduced by the actuators that its file declares stuck.
        loop: around the core; started and closed with this object.
        link: of the loop.
    """

    def __init__(self, arm: Arm, densities: Densities, loop: Loop, link: ExecutorLink) -> None:
        self._arm, self._densities, self._loop, self._link = arm, densities, loop, link
        self._decoder, self._description = RequestDecoder(arm), description(arm)
        self._numbers = itertools.count(1)

    def start(self) -> None:
        """Starts the loop, which connects to the executor."""
        self._loop.start()

    def end_goals(self) -> None:
        """Ends the running goal, and waits for its result; the executor stays connected."""
        self._loop.post(Quit())
        self._loop.ended.wait(LAST_RESULTS)

    def close(self) -> None:
        """Ends goals, the loop, and the connection to the executor."""
        self.end_goals()
        self._loop.close()
        self._link.close()

    # --- requests

    def decode(self, key: Key, payload: bytes) -> Message:
        """Returns the content of a request; see `RequestDecoder.decode`.

        Raises:
            Refusal: the payload is invalid.
        """
        return self._decoder.decode(key, payload)

    def request(self, key: Key, message: Message, reply: OnReply) -> None:
        """Posts a request. A stop, or a cancel without an id, goes to the executor before this method returns.

        Simultaneous requests of several threads may reach the core in another order than their numbers.

        Args:
            key: of the interface.
            message: of `decode`.
            reply: takes the answer, once, in the loop's thread; must not wait.
        """
        number = next(self._numbers)
        self._loop.request(Request(number, key, message, time.time()), reply)
        if key == "stop":
            reason = self._link.send_now(Halt(number))
        elif key == "cancel" and message == CancelMessage():
            reason = self._link.send_now(Cancel(number, None, CANCELED))
        else:
            return
        if reason is not None:
            self._loop.post(Unsent(number, reason))

    def read_setpoints(self, receive: Receive) -> None:
        """Sets the mailbox of set-points: `receive` returns the latest, or None, and never waits."""
        self._loop.read(SetpointArrived, receive)

    def read_measured_tips(self, receive: Receive) -> None:
        """Sets the mailbox of measured tips; see `read_setpoints`."""
        self._loop.read(TipArrived, receive)

    def description(self, wanted: Collection[str] = ()) -> Payload:
        """Returns the parts of the payload of `arm` that do not change.

        Args:
            wanted: parts to include besides: "drawing", "file", "density".
        """
        made: dict[str, Callable[[], Payload | None]] = {
            "drawing": lambda: drawing(self._arm),
            "file": lambda: file(self._arm),
            "density": lambda: density(self._densities, planar=self._arm.manipulator.planar),
        }
        return {**self._description, **{name: make() for name, make in made.items() if name in wanted}}
