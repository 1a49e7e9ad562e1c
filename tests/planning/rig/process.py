"""A planner in threads of this process: its loop, workers, ledger and link, with an inbox in place of Zenoh."""

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.host.notify import Notifier
from hyperbit.controller.planning.core.events import Published, PublishResult, Recorded
from hyperbit.controller.planning.ledger import Ledger, PublishedResults
from hyperbit.controller.planning.link import ExecutorLink
from hyperbit.controller.planning.link import Inbox as Events
from hyperbit.controller.planning.loop import Services
from hyperbit.controller.planning.planner import planning
from hyperbit.controller.workspace.densities import Densities
from tests.planning.rig.executor import DIGEST, Inbox


class RunningPlanner:
    """A planner that runs until `close`, or until `vanish`.

    Attributes:
        failures: sentences with which the process would have ended.
    """

    def __init__(self, arm: Arm, densities: Densities, socket: Path, folder: Path, inbox: Inbox) -> None:
        self.state, self.diagnostics, self.failures = dict[str, Any](), dict[str, Any](), list[str]()
        self._inbox, self._events = inbox, Events()
        self.ledger = Ledger(
            folder / "ledger.sqlite",
            arm.manipulator.actuators,
            lambda entry: self._events.post(Recorded(entry)),
            self.failures.append,
        )
        self._published = PublishedResults(folder / "published")
        self.link = ExecutorLink(socket, "small", DIGEST)
        services = Services(
            self._events, self.ledger, self._published, self, Notifier(), lambda: (), self.failures.append
        )
        self._end = ExitStack()
        self.planner = self._end.enter_context(planning(arm, densities, self.link, services))
        self.planner.loop.start()

    def close(self) -> None:
        self._end.close()
        self.ledger.close()
        assert not self.failures

    def vanish(self) -> None:
        """Ends like a process that is killed: it says nothing more."""
        self.planner.loop.close()
        self.ledger.close()

    def ask(self, key: Any, payload: Any = None, name: str = "reply") -> None:
        data = b"" if payload is None else json.dumps(payload).encode()
        message = self.planner.decoder.decode(key, data)
        self.planner.loop.request(
            self.planner.loop.arrive(), key, message, lambda answer: self._inbox.put(name, answer)
        )

    def publish(self, key: Any, payload: Any) -> None:
        if key == "feedback":
            self._inbox.put(key, payload)
        else:
            setattr(self, key, dict(payload))

    def publish_result(self, result: PublishResult) -> None:
        self._inbox.put("inherited" if result.inherited else "result", result.payload)
        self._published.add(result.identity, result.payload)
        self._events.post(Published(result.number))
