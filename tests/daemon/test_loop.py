"""What the control loop tells of itself, overload, and its end."""

from controller.daemon.events import Cancel, Quit, Stop
from controller.daemon.inbox import MOST_WAITING
from controller.daemon.loop import PERIOD
from tests.daemon.rig import A, B, C, Rig, states


def test_state_is_told_20_times_a_second_and_on_change(rig: Rig) -> None:
    rig.go(0.1)
    before = len(rig.snapshots)
    rig.go(1)
    assert 19 <= len(rig.snapshots) - before <= 21
    rig.request(Stop)
    rig.go()
    assert rig.snapshots[-1].mode == "stopped"


def test_diagnostics_are_told_every_second(rig: Rig) -> None:
    before = len(rig.diagnostics)
    rig.go(10)
    assert 9 <= len(rig.diagnostics) - before <= 11
    assert rig.diagnostics[-1].loop.overruns == 0


def test_the_watchdog_is_fed_by_good_ticks_only(rig: Rig) -> None:
    rig.go(1)
    assert 9 <= rig.notifier.sent.count("WATCHDOG=1") <= 12
    rig.notifier.sent.clear()
    rig.boards.broken = {"tick"}
    rig.go(1)
    assert "WATCHDOG=1" not in rig.notifier.sent


def test_every_mode_is_told_to_systemd(rig: Rig) -> None:
    rig.run("a", A)
    rig.go(0.5)
    assert [word for word in rig.notifier.sent if word != "WATCHDOG=1"] == [
        "READY=1",
        "STATUS=starting: the boards are being brought up",
        "STATUS=ready: holding what the boards measured",
        "STATUS=executing: goal a",
        "STATUS=ready: holding; goal a was reached",
    ]


def test_more_requests_than_can_wait_are_refused_but_a_stop_goes_on(rig: Rig) -> None:
    for _ in range(MOST_WAITING + 10):
        rig.request(Cancel)
    rig.run("a", A)
    assert [(name, reply["accepted"]) for name, reply in rig.replies] == [("cancel", False)] * 10 + [("a", False)]
    for _ in range(MOST_WAITING + 10):
        rig.request(Stop)
    assert [reply["message"] for _, reply in rig.replies[11:]] == ["an emergency stop is on its way already"] * 10
    rig.go((2 * MOST_WAITING + 1) * PERIOD)
    assert rig.loop.mode == "stopped"
    assert len(rig.replies) == 2 * MOST_WAITING + 21


def test_at_the_end_goal_and_waiting_requests_are_told(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.loop.inbox.put(Quit())
    rig.run("b", C)
    rig.request(Stop)
    rig.loop.run()
    rig.loop.inbox.close()
    rig.run("c", C)
    assert rig.results == [("a", "aborted")]
    assert rig.last_result["message"] == "the daemon is shutting down; the arm holds"
    late = [(name, reply["accepted"], reply["message"]) for name, reply in rig.replies[1:]]
    assert late == [(name, False, "the daemon is shutting down; the arm holds") for name in ("b", "stop", "c")]
    assert "STOPPING=1" in rig.notifier.sent
    assert (rig.snapshots[-1].mode, rig.snapshots[-1].goal) == ("ready", None)
    assert rig.boards.commits == [states(A)]
