"""The event loop, on a clock that stands still unless the test sets it."""

import math
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import DEFECT, Executor
from hyperbit.controller.executor.core.events import Defect, ExecutorTick, ToClient
from hyperbit.controller.executor.process.run import CLOSE, EventLoop
from hyperbit.controller.executor.process.server import ExecutorServer
from hyperbit.controller.host.notify import Notifier
from hyperbit.controller.program import (
    MOST_BYTES,
    TICK,
    VERSION,
    Accepted,
    Diagnostics,
    Ended,
    Hello,
    Program,
    Snapshot,
    Stage,
    decode_up,
    encode,
    pack,
)
from tests.executor.fake_master import FakeMaster
from tests.executor.rig import SIZE, small_arm


class NoBuses:
    """Buses without events, or with a defect."""

    broken = closed = False

    def filenos(self) -> list[int]:
        return []

    def wait(self, now: float) -> float:
        return math.inf

    def poll(self, now: float) -> list[Any]:
        if self.broken:
            raise RuntimeError("the bus is broken")
        return []

    def send_frame(self, bus: str, frame: Any, now: float) -> None:
        pass

    def close(self) -> None:
        self.closed = True


class Bench:
    """An event loop whose rounds the test runs; each takes one period."""

    def __init__(self, path: Path, **fields: Any) -> None:
        self.now, self.step = 10.0, TICK
        self.core = Executor(small_arm(**fields), SwitchJournal(SIZE), 1, build_master=FakeMaster)
        self.buses, self.server = NoBuses(), ExecutorServer(path, lambda: self.now)
        self.loop = EventLoop(self.core, self.buses, self.server, Notifier(), clock=lambda: self.now)
        self.loop.real_time.start(self.now + TICK)
        self.client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.client.settimeout(10)
        self.client.connect(str(path))
        self.send(Hello(VERSION, "planner", "small"))

    def send(self, message: Any) -> None:
        self.client.send(encode(message))

    def go(self, rounds: int) -> None:
        for _ in range(rounds):
            self.now += self.step
            self.loop.round()

    def wait(self, kind: type) -> Any:
        while True:
            message = decode_up(self.client.recv(MOST_BYTES))
            if isinstance(message, kind):
                return message

    def run(self) -> None:
        """Sends a program of two stages, the second much later."""
        state = self.wait(Snapshot)
        while state.mode != "ready":
            state = self.wait(Snapshot)
        stages = (Stage(pack(1, SIZE), at=0.0, mark=0), Stage(pack(0, SIZE), at=1e6, mark=1))
        self.send(Program(1, state.epoch, state.outputs, 0.0, stages, True, False, "goal 1"))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path / "arm.sock")
    yield bench
    bench.client.close()
    if not bench.buses.closed:
        bench.loop._end()


def test_a_program_is_acted_on_without_a_tick(bench: Bench) -> None:
    bench.go(10)
    bench.run()
    ticks = len(bench.core.master.ticks)
    bench.step = 0.0
    bench.now += 0.1 * TICK
    bench.loop.round()
    assert (bench.core.master.outputs, len(bench.core.master.ticks)) == (1, ticks)


def test_a_message_shortly_before_a_tick_waits_for_it(bench: Bench) -> None:
    bench.go(10)
    bench.run()
    bench.step = 0.0
    bench.now = bench.loop.real_time.next_tick - 0.5 * CLOSE
    bench.loop.round()
    assert bench.core.motion.execution is None
    bench.now = bench.loop.real_time.next_tick
    bench.loop.round()
    assert bench.core.motion.execution is not None


def test_messages_wait_for_the_echo_of_rpdos_until_the_next_tick(bench: Bench) -> None:
    def answers() -> list[Any]:
        return [it for it in bench.loop.queued if isinstance(it, ToClient) and isinstance(it.message, Accepted)]

    bench.go(10)
    bench.run()
    bench.core.master.slow_rpdos, bench.step = True, 0.0
    bench.go(20)
    assert len(answers()) == 1
    bench.step = TICK
    bench.go(1)
    assert answers() == []
    assert bench.wait(Accepted)


def test_a_defect_of_the_loop_is_a_fault_and_the_loop_continues(bench: Bench) -> None:
    bench.go(10)
    bench.run()
    bench.go(1)
    bench.buses.broken = True
    bench.go(10)
    assert (bench.core.modes.mode, bench.core.modes.reason) == ("fault", DEFECT.message)
    bench.buses.broken = False
    bench.go(10)
    assert bench.wait(Ended).status == "aborted"


def test_the_loop_reports_its_lateness(bench: Bench) -> None:
    bench.go(10)
    bench.now += 0.05
    bench.go(100)
    loop = bench.wait(Diagnostics).loop
    assert loop["overruns"] in (4, 5)
    assert loop["longest_period"] == pytest.approx(0.06)
    assert set(loop) >= {"ticks", "mean_work", "longest_work", "late_p99", "late_worst"}


def test_an_event_whose_step_fails_is_recorded_before_the_defect(bench: Bench) -> None:
    recorded = list[tuple[Any, bool]]()

    class Recorder:
        def __call__(self, event: Any, now: float, wall: float | None, actions: list[Any] | None) -> None:
            recorded.append((event, actions is None))

        def flush(self) -> None:
            pass

    def fail(event: Any, now: float) -> list[Any]:
        del bench.core.step  # the class has it
        raise RuntimeError("a defect")

    bench.go(10)
    bench.loop.recorder = Recorder()
    bench.core.step = fail
    bench.go(2)
    assert recorded[0] == (ExecutorTick(), True)
    assert isinstance(recorded[1][0], Defect)
    assert bench.core.modes.mode == "fault"


def test_at_the_end_the_result_is_sent_and_all_is_closed(bench: Bench, tmp_path: Path) -> None:
    bench.go(10)
    bench.run()
    bench.go(3)
    bench.loop.quit()
    bench.loop.run()
    assert bench.wait(Ended).status == "aborted"
    assert bench.buses.closed
    assert not (tmp_path / "arm.sock").exists()
    bench.loop.quit()  # a second signal, as of a parent that ends its child and dies then


def test_a_second_quit_does_not_wait_for_the_contraction(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "arm.sock", contract_on_stop=True)
    bench.go(10)
    bench.run()
    bench.go(20)
    assert bench.core.master.outputs == 1
    thread = threading.Thread(target=bench.loop.run, daemon=True)  # the clock stands still: no contraction ends
    bench.loop.quit()
    thread.start()
    while not bench.core.ending.begun:
        thread.join(0.01)
    assert (bench.core.ended, bench.buses.closed) == (False, False)
    bench.loop.quit()
    thread.join(60)
    assert (thread.is_alive(), bench.buses.closed) == (False, True)
    assert bench.wait(Ended).status == "aborted"
    bench.client.close()


def test_quit_wakes_the_loop_from_another_thread(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "arm.sock")
    bench.loop._clock = lambda: 10.0  # no tick is ever due again
    thread = threading.Thread(target=bench.loop.run)
    thread.start()
    bench.loop.quit()
    thread.join(30)
    assert not thread.is_alive()
    bench.client.close()
