"""The bridge's loop: makes the node once the arm is known, and publishes states at most 50 times a second."""

import logging
from collections.abc import Callable
from typing import Any

from hyperbit.controller.decoding.decoding import OTHER_FORM, decode
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import Result
from hyperbit.controller.messages.reading import UnreadCount
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.network.client import Client
from hyperbit.controller.network.listener import Listener, ReceivedMessage
from hyperbit.controller.ros2.arm_node import ArmNode, Settings
from hyperbit.controller.ros2.goal_book import GoalBook
from hyperbit.controller.ros2.wire.session import Session

PERIOD = 0.02  # [s] between two states
SLOW = 1.0  # [s] between two diagnostics, and between two repetitions of markers
ASK_EVERY = 5.0  # [s] for the arm's description, while there is none
log = logging.getLogger(__name__)


class Bridge:
    """Shows one arm to ROS 2."""

    def __init__(
        self, listener: Listener, client: Client, session: Session, book: GoalBook, settings: Settings
    ) -> None:
        self._listener, self._client, self._session = listener, client, session
        self._book, self._settings = book, settings
        self.node: ArmNode | None = None
        self.description = b""
        self._state: State | None = None  # the last one
        self._diagnostics: Diagnostics | None = None
        self._new_state = False
        self._unread = UnreadCount()
        self._asked = self._slow = -ASK_EVERY  # times of the last question and of slow messages [s]

    def run(self, ending: Callable[[], bool], beat: Callable[[], None]) -> None:
        """Runs until `ending` returns True; calls `beat` many times a second."""
        computer = self._session.computer
        while not ending():
            began = computer.monotonic()
            for item in self._listener.receive_messages(PERIOD):
                self._attempt(self.receive_message, item)
            self.tick(computer.monotonic())
            beat()
            computer.sleep(max(began + PERIOD - computer.monotonic(), 0.0))

    def close(self) -> None:
        """Ends the node and aborts its goals."""
        if self.node is not None:
            self.node.close()
            self.node = None

    def receive_message(self, item: ReceivedMessage) -> None:
        """Accepts a message of the arm. Raises OTHER_FORM and changes nothing if the message has another form."""
        node = self.node
        match item.key:
            case "arm":
                self._describe(item.data)
            case "alive" | "gone":
                if node is not None:
                    node.receive_alive(alive=item.key == "alive")
                self._asked = -ASK_EVERY if item.key == "alive" else self._asked
                self.description = b"" if item.key == "alive" else self.description
            case "state":
                state, before = decode(item.data, State), self._state
                if node is not None:
                    node.receive_state(state)
                if before is None or state.obstacles != before.obstacles:  # the description has the new ones
                    self.description = b""
                self._state, self._new_state = state, True
            case "diagnostics":
                self._diagnostics = decode(item.data, Diagnostics)
            case "result" if node is not None:
                node.receive_result(decode(item.data, Result))

    def tick(self, now: float) -> None:
        """Publishes what is new or due; `now` [s]."""
        if not self.description and now >= self._asked + ASK_EVERY:
            self._asked = now
            self._listener.ask()
        if self.node is None:
            return
        self.node.poll(now)
        if (state := self._state) is None:
            return
        if self._new_state:
            self._new_state = False
            self._attempt(self.node.publish_state, state)
        if now >= self._slow + SLOW:
            self._slow = now
            self._attempt(self.node.publish_slowly, state, self._diagnostics)

    def _attempt(self, function: Callable[..., None], *arguments: Any) -> None:
        """Calls a function. Counts a message that has another form than the daemon's, and goes on."""
        try:
            function(*arguments)
        except OTHER_FORM as error:
            self._unread.add("unknown" if self.node is None else self.node.name, function.__name__, error)

    def _describe(self, data: bytes) -> None:
        """Accepts the arm's description. Another arm needs a new node; other obstacles do not."""
        arm = decode(data, Description)
        if self.node is not None and self.node.describes(arm):
            self.node.receive_obstacles(arm)
        else:
            node = ArmNode(self._session, self._client, arm, self._book, self._settings)
            self.close()
            node.open()
            self.node = node
            log.info("the arm %s is node %s on domain %d", arm.name, node.name, self._settings.domain)
        self.description = data
