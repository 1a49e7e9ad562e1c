"""What becomes of setpoints: decided in this thread, on clocks that the test sets."""

import json
import math
from typing import Any

import numpy as np
import pytest

from controller.config import Arm
from controller.daemon.avoidance import Avoidance, keeping
from controller.daemon.events import Follow
from controller.daemon.follower import Follower
from controller.daemon.inbox import Inbox
from controller.search.solver import Solver
from tests.obstacles.dense import Disc, nearest

START = (0.55, 2.8)


class FakeLoop:
    """What the follower sees of the control loop; it switches to what is wished as soon as it is free."""

    def __init__(self, configuration: np.ndarray) -> None:
        self.inbox = Inbox()
        self.commanded: np.ndarray | None = configuration
        self.follow_after, self.free_at = 0, 0.0


class Field:
    """A goal that streams, and clocks."""

    def __init__(self, arm: Arm, solver: Solver) -> None:
        self.now, self.wall, self._arrival = 1000.0, 1.8e9, 0
        self.loop = FakeLoop(solver.solve(START, [0] * 16, 0.0005).configuration)
        self.avoidance = Avoidance(keeping(arm))
        self.follower = Follower(  # type: ignore[arg-type]
            arm, solver, self.loop, lambda: self.now, lambda: self.wall, avoidance=self.avoidance
        )
        self.wishes: list[Follow] = []
        self.switches: list[float] = []
        self._arm = arm

    def arrival(self) -> int:
        self._arrival += 1
        return self._arrival

    def send(self, x: float, y: float, **fields: Any) -> None:
        self.raw(json.dumps({"position": [x, y], **fields}).encode())

    def raw(self, payload: bytes) -> None:
        self.follower.take(payload, self.arrival())

    def go(self, seconds: float = 0.005) -> None:
        """Lets time pass; what is wished is done when the arm is free."""
        for _ in range(max(round(seconds / 0.005), 1)):
            self.now += 0.005
            self.wall += 0.005
            self.follower.consider()
            while self.loop.inbox.waiting():
                wish = self.loop.inbox.get(0)
                assert isinstance(wish, Follow)
                self.wishes.append(wish)
                if wish.configuration is not None and self.now >= self.loop.free_at:
                    self.loop.commanded, self.loop.free_at = wish.configuration, self.now + 0.06
                    self.switches.append(self.now)

    def stream(self, count: int = 25, speed: float = 0.1, **fields: Any) -> np.ndarray:
        """A goal that moves along x, at 50 Hz; returns where it is at last."""
        for k in range(count):
            x = START[0] - speed * 0.02 * k
            self.send(x, START[1], **fields)
            self.go(0.02)
        return np.array([x, START[1]])

    @property
    def tip(self) -> np.ndarray:
        return self._arm.manipulator.tip(self.loop.commanded)[:2, 3]


@pytest.fixture
def field(arm: Arm, solver: Solver) -> Field:
    return Field(arm, solver)


def test_a_goal_that_moves_is_followed_nearer_than_it_travels_meanwhile(field: Field) -> None:
    end = field.stream(100)
    assert len(field.switches) >= 10
    assert min(np.diff(field.switches)) >= 0.06 - 1e-9
    assert np.linalg.norm(field.tip - end) < 0.02, "0.2 m were gone"
    assert {wish.arrival for wish in field.wishes} == {1}
    assert all(wish.until > field.now - 2.5 and wish.reason == "following a setpoint" for wish in field.wishes)


def test_the_real_tip_follows_where_its_bias_is_known(field: Field) -> None:
    bias = np.array([0.02, -0.01])
    field.follower._bias = lambda: bias
    end = field.stream(100)
    assert np.linalg.norm(field.tip + bias - end) < 0.02 < np.linalg.norm(field.tip - end)
    field.go(3)
    for _ in range(25):
        field.send(*(field.tip + bias))
        field.go(0.02)
    assert not [at for at in field.switches if at > field.now - 1.0], "the real tip is there already"


def test_a_goal_within_the_tolerance_asks_for_nothing_but_is_told_alive(field: Field) -> None:
    for _ in range(25):
        field.send(*field.tip)
        field.go(0.02)
    assert field.switches == []
    assert 20 <= len(field.wishes) <= 30
    assert field.wishes[-1].until == pytest.approx(field.now, abs=0.26)
    status = field.follower.status()
    assert (status["received"], status["refused"], status["alive"]) == (25, 0, True)
    assert status["rate"] == pytest.approx(50, rel=0.05)


def test_the_goal_is_led_on_between_two_setpoints_and_given_up_after_the_timeout(field: Field) -> None:
    field.stream(25)
    told = len(field.wishes)
    field.go(0.2)
    assert len(field.wishes) > told
    assert field.wishes[-1].until <= field.now + 0.05
    field.go(0.1)
    told = len(field.wishes)
    field.go(1)
    assert len(field.wishes) == told
    assert (field.follower.status()["alive"], field.follower.status()["rate"]) == (False, 0.0)


BAD = {
    b"{": "not JSON",
    b"\xff": "not UTF-8",
    b"": "not JSON",
    b'{"position": [NaN, 1]}': "position[0]: nan",
    b'{"position": [1, 2, 3]}': "3 coordinates",
    b'{"position": [1, 2], "speed": 1}': "speed: unknown field",
    b'{"position": [1, 2], "stamp": 1}': "old on arrival",
    b'{"position": [1, 2], "stamp": 9e9}': "in the future",
    b" " * 20_000: "20000 bytes",
}


def test_bad_setpoints_are_counted_and_change_nothing(field: Field) -> None:
    for payload, words in BAD.items():
        field.raw(payload)
        field.go(0.02)
        assert words in field.follower.status()["last_refusal"]
    status = field.follower.status()
    assert (status["received"], status["refused"], status["alive"]) == (len(BAD), len(BAD), False)
    assert field.wishes == []
    field.stream(2)
    assert field.wishes


def test_stamps_out_of_order_are_refused(field: Field) -> None:
    field.send(*START, stamp=field.wall)
    field.send(*START, stamp=field.wall)
    assert "before the last one taken" in field.follower.status()["last_refusal"]


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("step", [-3600.0, -0.1, 0.1, 3600.0])
def test_a_step_of_the_wall_clock_moves_nothing(field: Field, step: float, stamped: bool) -> None:
    tip = field.tip
    for k in range(100):
        field.wall += step if k == 50 else 0
        field.send(*tip, **({"stamp": field.wall} if stamped else {}))
        field.go(0.02)
    assert field.switches == []
    assert field.follower.status()["alive"], "it recovers"


def test_what_ends_following_ends_it_until_a_fresh_stream(field: Field) -> None:
    field.stream(10)
    field.loop.follow_after = field.arrival()
    told = len(field.wishes)
    field.stream(50)
    assert len(field.wishes) == told
    assert not field.follower.status()["alive"]
    field.go(0.3)
    field.stream(2)
    assert field.wishes[-1].arrival > field.loop.follow_after


def test_garbage_does_not_keep_an_ended_stream_running(field: Field) -> None:
    field.stream(10)
    field.loop.follow_after = field.arrival()
    for _ in range(20):
        field.raw(b"garbage")
        field.go(0.02)
    field.stream(2)
    assert field.wishes[-1].arrival > field.loop.follow_after


def test_out_of_reach_moves_nothing_and_says_so_seldom(field: Field) -> None:
    for k in range(100):
        field.send(9.0 + 0.001 * k, 9.0)
        field.go(0.02)
    assert field.switches == []
    reasons = {wish.reason for wish in field.wishes}
    assert len(reasons) <= 3
    assert "out of reach" in field.wishes[-1].reason
    for _ in range(60):
        field.send(*field.tip)
        field.go(0.02)
    assert field.wishes[-1].reason == "following a setpoint"


def test_a_looser_tolerance_switches_less(field: Field, arm: Arm, solver: Solver) -> None:
    field.stream(50)
    other = Field(arm, solver)
    other.stream(50, tolerance={"position": 0.05})
    assert len(other.switches) < len(field.switches)


def test_before_the_configuration_is_known_the_stream_is_only_told(field: Field) -> None:
    field.loop.commanded = None
    field.stream(5)
    assert field.wishes
    assert all(wish.configuration is None for wish in field.wishes)


def test_a_loop_that_is_behind_is_not_flooded(field: Field) -> None:
    field.send(*START)
    for _ in range(1000):
        field.now += 0.005
        field.send(*START)
        field.follower.consider()
    assert field.loop.inbox.waiting() <= 20


def test_a_defect_ends_the_stream_and_not_the_thread(field: Field, caplog: pytest.LogCaptureFixture) -> None:
    field.send(*START)
    for _ in range(10):
        try:
            raise ZeroDivisionError
        except ZeroDivisionError:
            field.follower._give_up()
    assert caplog.text.count("the arm holds") == 1
    field.stream(5)
    assert field.wishes == []
    field.go(0.3)
    field.stream(5)
    assert field.wishes
    assert math.isfinite(field.wishes[-1].until)


def test_a_goal_that_moves_into_a_region_is_followed_as_far_as_nothing_is_touched(field: Field) -> None:
    arm, post = field._arm.manipulator, Disc((START[0] - 0.6, START[1]), 0.05)
    field.avoidance.kept = keeping(field._arm, post.region())
    field.stream(31, speed=1.0)
    for _ in range(60):  # until what is said of it may change
        field.send(*post.centre)
        field.go(0.02)
    moved = [wish for wish in field.wishes if wish.configuration is not None]
    assert moved
    for wish in moved:
        assert wish.stages is not None
        assert wish.previous is not None
        assert wish.stages[-1].tolist() == arm.actuator_states(wish.configuration).tolist()
        assert field.avoidance.kept.touched(arm.actuator_states(wish.previous), wish.stages) is None
        assert all(nearest(arm.body(arm.configuration(stage)), [post]) > 0 for stage in wish.stages)
    assert "out of reach at (" in field.wishes[-1].reason or "barred: " in field.wishes[-1].reason


def test_without_regions_wishes_have_no_stages(field: Field) -> None:
    field.stream(25)
    assert field.switches
    assert all(wish.stages is None for wish in field.wishes)
