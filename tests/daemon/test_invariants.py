"""What holds for the control loop whatever happens in whatever order."""

from collections import Counter
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from controller.daemon.events import Cancel, Quit, Reset, Stop
from drivers.faults import Fault
from tests.daemon.rig import ARM, Rig

FAULT = Fault("board-lost", "can0/1", "lost")
LEGAL = {
    ("starting", "ready"), ("starting", "fault"), ("starting", "stopped"),
    ("ready", "executing"), ("ready", "fault"), ("ready", "stopped"),
    ("executing", "ready"), ("executing", "fault"), ("executing", "stopped"),
    ("fault", "starting"), ("fault", "stopped"),
    ("stopped", "starting"),
}  # fmt: skip

configurations = st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), min_size=1, max_size=4)
acts = st.one_of(
    st.tuples(st.just("goal"), configurations),
    st.tuples(st.just("old goal"), configurations),
    st.tuples(st.sampled_from(["cancel", "stop", "reset", "fault", "busy", "stuck", "missing", "defect"]), st.none()),
    st.tuples(st.sampled_from(["follow", "follow anew"]), st.none() | st.tuples(st.integers(0, 7), st.integers(0, 7))),
    st.tuples(st.just("go"), st.integers(1, 60)),
)


@given(st.lists(acts, max_size=40))
def test_whatever_happens(sequence: list[tuple[str, object]]) -> None:
    rig = Rig()
    boards, modes, goals, stream = rig.boards, [rig.loop.mode], 0, rig.arrival()
    for act, argument in [*sequence, ("go", 30)]:
        match act:
            case "goal" | "old goal":
                goals += 1
                rig.run(f"goal {goals}", *argument, arrival=1 if act == "old goal" else None)  # type: ignore[misc]
            case "follow" | "follow anew":
                stream = rig.arrival() if act == "follow anew" else stream
                rig.follow(stream, argument)  # type: ignore[arg-type]
            case "cancel" | "stop" | "reset":
                rig.request({"cancel": Cancel, "stop": Stop, "reset": Reset}[act])
            case "fault":
                boards.fail(FAULT)
            case "busy" | "stuck":
                setattr(boards, act, not getattr(boards, act))
            case "missing":
                boards.missing = [] if boards.missing else [FAULT]
            case "defect":
                boards.broken = set() if boards.broken else {"commit"}
            case "go":
                for _ in range(argument):  # type: ignore[call-overload]
                    before, commits = rig.loop.mode, len(boards.commits)
                    rig.go()
                    if rig.loop.mode != before:
                        modes.append(rig.loop.mode)
                    may_move = {before, rig.loop.mode} & {"executing"}
                    assert len(boards.commits) <= commits + bool(may_move), f"switched in {before}"
    while rig.loop.inbox.waiting():  # let it act on all it was told
        rig.go()
    running = rig.loop.mode == "executing" and rig.loop.reason.startswith("goal")
    accepted = [name for name, reply in rig.replies if name.startswith("goal") and reply["accepted"]]
    answered = [name for name, _ in rig.replies if name.startswith("goal")]
    assert sorted(answered) == sorted(f"goal {k + 1}" for k in range(goals)), "each goal is answered once"
    assert len(rig.replies) == sum(act in ("goal", "old goal", "cancel", "stop", "reset") for act, _ in sequence)
    rig.loop.inbox.put(Quit())
    rig.loop.run()
    assert Counter(name for name, _ in rig.results) == Counter(accepted), "each accepted goal has one result"
    if running:
        assert rig.results[-1] == (accepted[-1], "aborted")
    assert all(len(entries) == 2 for entries in rig.ledger.goals.values())
    assert all(pair in LEGAL or pair[0] == pair[1] for pair in pairwise(modes)), modes
    assert all(set(states) <= {0, 1} and len(states) == len(ARM.actuators) for states in boards.commits)
