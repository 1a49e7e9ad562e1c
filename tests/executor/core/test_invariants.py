"""Invariants of the executor under random events."""

from collections import Counter
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import (
    Accepted,
    Answer,
    Cancel,
    Declined,
    Ended,
    Lock,
    Replacement,
    Reset,
    Stage,
    Stop,
    pack,
)
from tests.executor.rig import LOST, SIZE, TRAVEL, Rig, ready

LEGAL = {
    ("starting", "ready"), ("starting", "fault"), ("starting", "stopped"),
    ("ready", "executing"), ("ready", "fault"), ("ready", "stopped"), ("ready", "starting"),
    ("executing", "ready"), ("executing", "fault"), ("executing", "stopped"),
    ("fault", "starting"), ("fault", "stopped"),
    ("stopped", "starting"),
}  # fmt: skip

states = st.integers(0, (1 << SIZE) - 1)
stages = st.lists(states, max_size=4)
acts = st.one_of(
    st.tuples(st.sampled_from(["program", "strict", "open", "old", "replace", "follow"]), stages),
    st.tuples(st.sampled_from(["cancel", "halt", "reset", "fault", "missing", "back", "defect", "gone"]), st.none()),
    st.tuples(st.sampled_from(["busy", "slow_sync"]), st.none()),
    st.tuples(st.sampled_from(["stuck", "partly"]), states),
    st.tuples(st.just("lock"), st.tuples(st.integers(0, SIZE - 1), st.integers(-1, 1))),
    st.tuples(st.just("stall"), st.floats(0.0, 0.5)),
    st.tuples(st.just("go"), st.integers(1, 60)),
)


def act(rig: Rig, name: str, argument: object) -> None:
    match name:
        case "program" | "strict" | "open":
            rig.run(*argument, strict=name == "strict", final=name != "open", step=0.06)  # type: ignore[misc]
        case "old":
            rig.run(*argument, epoch=0)  # type: ignore[misc]
        case "replace":
            new = tuple(Stage(pack(bits, SIZE), at=0.2) for bits in argument)  # type: ignore[attr-defined]
            rig.send(Replacement(rig.programs, 1, 1, pack(rig.master.outputs, SIZE), new, True))
        case "follow":
            rig.follow(10_000 + rig.programs, *argument)  # type: ignore[misc]
        case "cancel":
            rig.send(Cancel(1, None, ""))
        case "halt" | "reset":
            rig.send(Stop(1) if name == "halt" else Reset(1, rig.epoch))
        case "fault":
            rig.master.fail(LOST)
        case "missing":
            rig.master.boot_faults = [] if rig.master.boot_faults else [LOST]
        case "back" | "busy" | "slow_sync":
            setattr(rig.master, name, not getattr(rig.master, name))
        case "stuck" | "partly":
            setattr(rig.master, name, argument)
        case "defect":
            rig.master.broken = set() if rig.master.broken else {"commit"}
        case "gone":
            rig.gone()
            rig.connect()
        case "lock":
            rig.send(Lock(1, *argument))  # type: ignore[misc]
        case "stall":
            rig.agenda.run(argument)  # type: ignore[operator]


@given(st.lists(acts, max_size=30), st.sampled_from([None, 2, 6]), st.sampled_from([0.0, 0.1]))
def test_whatever_happens(sequence: list[tuple[str, object]], inrush: int | None, rest: float) -> None:
    rig = ready(inrush=inrush, rest=rest)
    modes = [rig.mode]
    for name, argument in [*sequence, ("go", 30)]:
        for _ in range(argument if name == "go" else 1):  # type: ignore[arg-type]
            before, commits = rig.mode, len(rig.switched)
            if name == "go":
                rig.go()
            else:
                act(rig, name, argument)
            if rig.mode != before:
                modes.append(rig.mode)
            moved = len(rig.switched) > commits
            assert not moved or "executing" in (before, rig.mode) or name in ("program", "strict", "open", "follow")
    accepted = Counter(message.program for message in rig.of(Accepted))
    declined = Counter(message.program for message in rig.of(Declined))
    assert set((accepted + declined).values()) <= {1}, "each program is answered once"
    rig.master.broken, rig.master.slow_sync = set(), False
    rig.do(Quit())
    rig.go()
    rig.do(Quit())
    ended = {message.result: message.program for message in rig.of(Ended)}
    assert Counter(ended.values()) == accepted, "each accepted program has one result"
    asked = sum(name in ("cancel", "halt", "reset", "lock") for name, _ in sequence)
    assert len(rig.of(Answer)) == asked
    assert all(pair in LEGAL or pair[0] == pair[1] for pair in pairwise(modes)), modes
    check_switches(rig, inrush)


def check_switches(rig: Rig, inrush: int | None) -> None:
    times = [at for at, _ in rig.master.left]
    masks = [mask for _, mask in rig.master.left]
    assert all(mask.bit_count() <= (inrush or SIZE) for mask in masks)
    if inrush is not None:
        assert all(b - a >= TRAVEL - 1e-9 for a, b in pairwise(times)), "a stage began before the last one's end"
    counted = [sum(mask >> k & 1 for mask in masks) for k in range(SIZE)]
    rig.journal.resolve(rig.master.outputs)
    assert rig.journal.counts == counted, "every switch is counted, once"
