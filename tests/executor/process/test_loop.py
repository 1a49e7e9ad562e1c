"""The event loop, on a clock that stands still unless the test sets it; its period, and its garbage."""

import gc
import math
import socket
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec import UNSET
from msgspec.structs import asdict, astuple

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import DEFECT, Executor
from hyperbit.controller.executor.core.events import Defect, ExecutorTick, ToClient
from hyperbit.controller.executor.process.run import CLOSE, TOO_MANY, WORTH, EventLoop, Garbage, Timekeeper
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


class Core(Executor):
    """A core whose step fails once on request."""

    fails = False

    def step(self, event: Any, now: float) -> list[Any]:
        if self.fails:
            self.fails = False
            raise RuntimeError("a defect")
        return super().step(event, now)


class Recorder(list[Any]):
    """Lists events, and whether their step failed."""

    def __call__(self, event: Any, now: float, wall: float | None, actions: list[Any] | None) -> None:
        self.append((event, actions is None))

    def flush(self) -> None:
        pass


class Bench:
    """An event loop whose rounds the test runs; each takes one period."""

    def __init__(self, path: Path, **fields: Any) -> None:
        self.now, self.step = 10.0, TICK
        self.core = Core(small_arm(**fields), SwitchJournal(SIZE), 1, build_master=FakeMaster)
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
        self.go(10)
        state = self.wait(Snapshot)
        while state.mode != "ready":
            state = self.wait(Snapshot)
        stages = (Stage(pack(1, SIZE), at=0.0, mark=0), Stage(pack(0, SIZE), at=1e6, mark=1))
        self.send(Program(1, state.epoch, state.outputs, 0.0, stages, True, False, "goal 1"))

    def in_thread(self) -> threading.Thread:
        """Runs the loop; the clock stands still, so that no tick is due again, and no contraction ends."""
        thread = threading.Thread(target=self.loop.run, daemon=True)
        thread.start()
        return thread


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path / "arm.sock")
    yield bench
    bench.client.close()
    if not bench.buses.closed:
        bench.server.close()


def test_a_program_is_acted_on_without_a_tick(bench: Bench) -> None:
    bench.run()
    ticks = len(bench.core.master.ticks)
    bench.step = 0.1 * TICK
    bench.go(1)
    assert (bench.core.master.outputs.commanded, len(bench.core.master.ticks)) == (1, ticks)


def test_a_message_shortly_before_a_tick_waits_for_it(bench: Bench) -> None:
    bench.run()
    bench.now = bench.loop.real_time.next_tick - 0.5 * CLOSE
    bench.loop.round()
    assert bench.core.motion.execution is None
    bench.now = bench.loop.real_time.next_tick
    bench.loop.round()
    assert bench.core.motion.execution is not None


def test_messages_wait_for_the_echo_of_rpdos_until_the_next_tick(bench: Bench) -> None:
    def answers() -> list[Any]:
        return [it for it in bench.loop.queued if isinstance(it, ToClient) and isinstance(it.message, Accepted)]

    bench.run()
    bench.core.master.slow_rpdos, bench.step = True, 0.0
    bench.go(20)
    assert len(answers()) == 1
    bench.step = TICK
    bench.go(1)
    assert answers() == []
    assert bench.wait(Accepted)


def test_a_defect_of_the_loop_is_a_fault_and_the_loop_continues(bench: Bench) -> None:
    bench.run()
    bench.go(1)
    bench.buses.broken = True
    bench.go(10)
    assert (bench.core.modes.mode, bench.core.modes.reason) == ("fault", DEFECT.message)
    bench.buses.broken = False
    bench.go(10)
    assert bench.wait(Ended).status == "aborted"


def test_an_event_whose_step_fails_is_recorded_before_the_defect(bench: Bench) -> None:
    bench.go(10)
    bench.loop.recorder = recorder = Recorder()
    bench.core.fails = True
    bench.go(2)
    assert recorder[0] == (ExecutorTick(), True)
    assert isinstance(recorder[1][0], Defect)
    assert bench.core.modes.mode == "fault"


def test_the_loop_reports_its_lateness(bench: Bench) -> None:
    bench.go(10)
    bench.now += 0.05
    bench.go(100)
    loop = bench.wait(Diagnostics).loop
    assert loop.overruns in (4, 5)
    assert loop.longest_period == pytest.approx(0.06)
    assert UNSET not in astuple(loop)


def test_at_the_end_the_result_is_sent_and_all_is_closed(bench: Bench, tmp_path: Path) -> None:
    bench.run()
    bench.go(3)
    thread = bench.in_thread()
    bench.loop.quit()
    thread.join(30)
    assert not thread.is_alive()
    assert bench.wait(Ended).status == "aborted"
    assert bench.buses.closed
    assert not (tmp_path / "arm.sock").exists()
    bench.loop.quit()  # a second signal, as of a parent that ends its child and dies then


def test_a_second_quit_does_not_wait_for_the_contraction(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "arm.sock", contract_on_stop=True)
    bench.run()
    bench.go(20)
    assert bench.core.master.outputs.commanded == 1
    bench.loop.quit()
    thread = bench.in_thread()
    while not bench.core.ending.begun:
        thread.join(0.01)
    assert (bench.core.ended, bench.buses.closed) == (False, False)
    bench.loop.quit()
    thread.join(60)
    assert (thread.is_alive(), bench.buses.closed) == (False, True)
    assert bench.wait(Ended).status == "aborted"
    bench.client.close()


def test_ticks_are_due_by_the_period_and_missed_ones_are_counted_and_skipped() -> None:
    keeper = Timekeeper(TICK)
    keeper.start(50.0)
    assert keeper.remaining(50.0) == 0
    keeper.ticked(50.0, 50.001, TICK)
    assert keeper.remaining(50.002) == pytest.approx(0.008)
    keeper.ticked(50.015, 50.018, TICK)
    assert keeper.remaining(50.018) == pytest.approx(0.002), "a late tick does not shift the next"
    assert asdict(keeper.drain_figures()) == {
        "ticks": 2,
        "overruns": 0,
        "longest_period": pytest.approx(0.015),
        "mean_work": pytest.approx(0.002),
        "longest_work": pytest.approx(0.003),
        "late_p50": pytest.approx(0.005),
        "late_p99": pytest.approx(0.005),
        "late_worst": pytest.approx(0.005),
    }
    assert not any(astuple(keeper.drain_figures()))
    keeper.ticked(50.02, 50.054, TICK)
    assert keeper.remaining(50.054) == pytest.approx(0.006)
    assert keeper.drain_figures().overruns == 3


def test_a_rest_has_several_periods_and_its_end_returns_to_the_phase() -> None:
    keeper = Timekeeper(TICK)
    keeper.start(50.0)
    keeper.ticked(50.0, 50.001, 5 * TICK)
    assert keeper.rests
    assert keeper.remaining(50.001) == pytest.approx(0.049)
    keeper.hurry(50.023)
    assert not keeper.rests
    assert keeper.remaining(50.023) == pytest.approx(0.007)
    keeper.ticked(50.03, 50.031, 3 * TICK)
    keeper.ticked(50.064, 50.065, TICK)
    assert keeper.drain_figures().longest_period == pytest.approx(0.014), "less by the periods that were planned"
    assert keeper.remaining(50.065) == pytest.approx(0.005)


class Cycle:
    def __init__(self) -> None:
        self.own = self


def left(count: int) -> list[weakref.ref[Cycle]]:
    return [weakref.ref(Cycle()) for _ in range(count)]


def gone(references: list[weakref.ref[Cycle]]) -> bool:
    return all(reference() is None for reference in references)


def test_garbage_is_collected_by_a_holding_arm_and_by_a_busy_one_if_it_is_too_much() -> None:
    with Garbage() as garbage:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 1000
        references = left(WORTH + 1)
        garbage.collect(holding=False)
        assert not gone(references), "nothing is collected by itself"
        garbage.collect(holding=True)
        assert gone(references)
        cycles = [Cycle() for _ in range(TOO_MANY)]
        references = left(TOO_MANY)
        garbage.collect(holding=False)
        assert gone(references)
        older = [weakref.ref(cycle) for cycle in cycles]
        del cycles
        garbage.collect(holding=False)
        assert not gone(older[:-1]), "the youngest alone"
        garbage.collect(holding=True)
        assert gone(older[:-1])
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
