"""An arm whose executor and planner are killed or stopped at random times, and the invariants that must hold."""

import itertools
import signal
from contextlib import ExitStack

import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client, Message
from tests.system.operator import Operator
from tests.system.stack.motions import Motions
from tests.system.stack.observer import Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT
from tests.system.stack.publisher import Publisher
from tests.system.stack.system import LEASE, System
from tests.waiting import PATIENCE, eventually

NEED_RESET = {"halted", "emergency", "board-stopped", "board-rebooted"}
STALLED = NEED_RESET | {"board-lost"}  # faults caused by a stall of a process on a busy machine


class Lives:
    """Executors and planners, one after another, each in a process of its own.

    Planners connect to the observer's session, which listens. It therefore receives all messages, from the first on.

    Attributes:
        motions: of the boards, from the first start on.
    """

    def __init__(self, system: System, stack: ExitStack, lease: float = PATIENCE) -> None:
        self.system, self._stack = system, stack
        config = session.configuration("peer", listen=system.endpoint)
        config.insert_json5(LEASE, str(round(1e3 * lease)))  # long, so that a stopped process keeps its session
        self.session: zenoh.Session = stack.enter_context(zenoh.open(config))
        self.client = Observer(Client(self.session, system.name))
        self.motions = Motions(system.wiring, stack.enter_context(system.listener()), system.interface.flush)
        system.start_executor()
        system.start_planner_process(lease)

    def ready(self) -> Message:
        """Waits until the arm is ready for goals, with a reset if a fault needs one; returns that state."""

        def there() -> Message | None:
            state = self.client.next_state()
            if state["mode"] == "fault" and set(self.client.codes) & NEED_RESET:
                self.client.ask("reset")
            return state if state["mode"] == "ready" else None

        return eventually(there, told=self.system.logs)

    def send(self, name: str, *positions: tuple[float, ...], times: list[float] | None = None) -> str:
        """Sends a goal until it is accepted; returns its id. A stall of the machine may have ended the mode ready."""
        attempts = itertools.count()

        def accepted() -> str | None:
            self.ready()
            goal = f"{name} {next(attempts)}"
            return goal if self.client.goal(*positions, times=times, id=goal)["accepted"] else None

        return eventually(accepted, told=self.system.logs, every=0.1)

    def move(self, name: str, *positions: tuple[float, ...]) -> None:
        """Sends a goal until one succeeds; only faults caused by a stall of the machine may end it."""
        for attempt in itertools.count():
            began = len(self.client.heard["state"])
            result = self.client.result(self.send(f"{name} {attempt}", *positions))
            if result["status"] == "succeeded":
                return
            codes = {fault["code"] for state in self.client.heard["state"][began:] for fault in state["faults"]}
            assert attempt < 20, result
            assert codes & STALLED, result

    def zigzag(self, name: str) -> str:
        """Sends a goal of many waypoints, as fast as the arm may follow, and a last one far ahead; returns its id."""
        times = [*(0.08 * k for k in range(30)), HOUR]
        return self.send(name, *((LEFT, RIGHT, MIDDLE)[k % 3] for k in range(31)), times=times)

    def rests(self) -> None:
        """Asserts that nothing moves by itself, and that the state of the ready arm is that of the boards."""
        boards = self.system.boards
        self.motions.agree(boards)
        before = boards.switches().tolist()
        state = self.ready()
        assert boards.switches().tolist() == before, "nothing moved by itself"
        assert state["commanded"] == state["measured"] == boards.positions().astype(int).tolist()

    def begun(self) -> None:
        before = self.motions.switched.sum()

        def moved() -> bool:
            self.motions.read()
            return bool(self.motions.switched.sum() > before)

        eventually(moved)

    def publisher(self) -> Publisher:
        return Publisher(self.session, self.client, self.system.name)

    def operator(self) -> Operator:
        return self._stack.enter_context(Operator(self.system.socket))

    def disturb(self, victim: str, number: signal.Signals) -> None:
        """Kills a process and starts it again; or stops it until the others have detected that, and continues it."""
        if number is signal.SIGKILL:
            self.kill(victim)
        elif victim == "planner":
            self.system.planner.freeze()
            with Operator(self.system.socket) as operator:
                eventually(lambda: operator.snapshot().mode != "executing")
            self.system.planner.thaw()
        else:
            self.system.executor.freeze()
            eventually(self.masterless)
            self.system.executor.thaw()

    def kill(self, victim: str) -> None:
        if victim == "planner":
            self.system.planner.kill()
            self.system.start_planner_process()
        else:
            self.system.executor.kill()
            self.system.start_executor()

    def masterless(self) -> bool:
        """Whether no board is operational, as all have lost the executor."""
        with self.system.boards.lock:
            boards = self.system.boards.boards.by_name.values()
            return all(board.state != 5 for board in boards)

    def check(self) -> None:
        """Asserts one result of each goal, and equal counts on the bus, in the boards and in the executor."""
        for goal in self.client.accepted:
            assert len(self.client.results(goal)) == 1, (goal, self.client.results(goal))
        self.motions.agree(self.system.boards)
        with Operator(self.system.socket) as operator:
            assert operator.counts() == self.motions.switched.tolist()
