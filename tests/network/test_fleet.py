"""All arms of a network over routers and below namespaces, and a stop for all of them."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack, closing

import pytest
import zenoh

from hyperbit.controller.network import fleet as fleets
from hyperbit.controller.network import session
from hyperbit.controller.network.fleet import LIST_TIMEOUT, ArmAddress, ArmStatus, Fleet, address_of, alive
from hyperbit.controller.network.stop_all import stop_all
from tests.endpoints import free_endpoint
from tests.network.played import PlayedArm, Router
from tests.strangers import intrude
from tests.waiting import PATIENCE, eventually

# An arm in a process of its own, until its standard input ends.
ARM = """
import sys, zenoh
from hyperbit.controller.network import session
with zenoh.open(session.configuration("peer", listen=sys.argv[1])) as opened:
    token = opened.liveliness().declare_token("hyperbit/a/alive")
    print(flush=True)
    sys.stdin.read()
"""
HERE, THERE, DEEP = ArmAddress("", "a"), ArmAddress("cell1", "a"), ArmAddress("plant/cell2", "a")


@pytest.fixture
def router(stack: ExitStack) -> Router:
    return Router(stack)


@pytest.fixture
def viewer(stack: ExitStack, router: Router) -> zenoh.Session:
    return stack.enter_context(zenoh.open(router.client()))


@pytest.fixture
def fleet(stack: ExitStack, viewer: zenoh.Session) -> Fleet:
    return stack.enter_context(closing(Fleet(viewer)))


def awaited(fleet: Fleet, what: Callable[[dict[ArmAddress, ArmStatus]], bool]) -> dict[ArmAddress, ArmStatus]:
    def look() -> dict[ArmAddress, ArmStatus] | None:
        fleet.ask()
        arms = {arm.address: arm for arm in fleet.arms()}
        return arms if what(arms) else None

    return eventually(look, told=lambda: str(fleet.arms())) or {}


def living(arms: dict[ArmAddress, ArmStatus]) -> set[ArmAddress]:
    return {address for address, arm in arms.items() if arm.gone_at is None}


@pytest.mark.parametrize(
    ("key", "address"),
    [
        ("hyperbit/left/state", ArmAddress("", "left")),
        ("plant/cell2/hyperbit/left/alive", ArmAddress("plant/cell2", "left")),
        ("plant/hyperbit/odd/hyperbit/left/alive", ArmAddress("plant/hyperbit/odd", "left")),
        ("hyperbit/le ft/state", None),
        ("hyperbit/*/state", None),
        ("hyperbit/state", None),
        ("hyperbits/left/state", None),
    ],
)
def test_a_key_names_its_arm(key: str, address: ArmAddress | None) -> None:
    assert address_of(key) == address
    assert address is None or key.startswith(f"{address.prefix}/")


def test_equal_names_in_several_namespaces_are_all_found(stack: ExitStack, router: Router, fleet: Fleet) -> None:
    arms = {address: PlayedArm(stack, router.client(address.namespace)) for address in (HERE, THERE, DEEP)}
    found = awaited(fleet, lambda found: living(found) == arms.keys() and all(arm.host for arm in found.values()))
    assert all(arm.state is None and arm.is_old for arm in found.values())
    for address, arm in arms.items():
        arm.state(goal=str(address))
    found = awaited(fleet, lambda found: all(arm.state for arm in found.values()))
    assert [arm.state and arm.state.goal for arm in found.values()] == [str(address) for address in arms]
    assert {(arm.host, arm.version) for arm in found.values()} == {("here", "9.9")}


def test_an_arm_that_ends_is_gone_and_comes_back_as_one_row(stack: ExitStack, router: Router, fleet: Fleet) -> None:
    PlayedArm(stack, router.client("cell1"))
    for _ in range(2):
        arm = PlayedArm(stack, router.client())
        awaited(fleet, lambda arms: living(arms) == {HERE, THERE} and arms[HERE].host == "here")
        arm.end()
        gone = awaited(fleet, lambda arms: living(arms) == {THERE})
        assert gone.keys() == {HERE, THERE}
        assert gone[HERE].gone_at is not None


def test_all_rows_come_back_after_the_router_was_ended(stack: ExitStack, router: Router, fleet: Fleet) -> None:
    arms = [PlayedArm(stack, router.client(namespace)) for namespace in ("", "cell1")]
    awaited(fleet, lambda arms: living(arms) == {HERE, THERE})
    router.end()
    assert awaited(fleet, lambda arms: not living(arms)).keys() == {HERE, THERE}
    router.start()
    awaited(fleet, lambda arms: living(arms) == {HERE, THERE})

    def heard() -> bool:
        for arm in arms:
            arm.state(goal="afterwards")
        return [arm.state and arm.state.goal for arm in fleet.arms()] == ["afterwards"] * 2

    eventually(heard)


def test_malformed_states_harm_no_other_arm(stack: ExitStack, router: Router, fleet: Fleet) -> None:
    payloads = (b"", b"\xff", b"[" * 5000, b'{"mode": 1}', b'{"mode": "ready", "faults": [{}]}')
    broken = [PlayedArm(stack, router.client(), f"a{k}") for k in range(len(payloads))]
    whole = PlayedArm(stack, router.client(), "whole")

    def heard() -> bool:
        for arm, payload in zip(broken, payloads, strict=True):
            arm.put("state", payload)
        whole.state()
        arms = fleet.arms()
        return len(arms) == len(payloads) + 1 and all(arm.age is not None for arm in arms)

    eventually(heard)
    assert [arm.state and arm.state.mode for arm in fleet.arms()] == [None] * len(payloads) + ["ready"]


def test_a_stop_for_all_reaches_each_arm(stack: ExitStack, router: Router, viewer: zenoh.Session) -> None:
    arms = {address: PlayedArm(stack, router.client(address.namespace)) for address in (HERE, THERE, DEEP)}
    eventually(lambda: alive(viewer) == sorted(arms))
    report = stop_all(viewer, timeout=PATIENCE)
    assert report.complete
    assert report.answers.keys() == arms.keys()
    assert [arm.commands() for arm in arms.values()] == [["stop"]] * 3, "once each"


def test_a_stop_for_all_of_one_namespace_leaves_the_others(
    stack: ExitStack, router: Router, viewer: zenoh.Session
) -> None:
    arms = {address: PlayedArm(stack, router.client(address.namespace)) for address in (HERE, THERE)}
    eventually(lambda: alive(viewer) == sorted(arms))
    assert stop_all(viewer, ("hyperbit/*",), timeout=PATIENCE).answers.keys() == {HERE}
    assert arms[THERE].asked == []


def test_a_stranger_takes_no_arm_from_the_list_and_no_stop(
    stack: ExitStack, router: Router, viewer: zenoh.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleets, "MOST_ARMS", 2)
    stranger = stack.enter_context(zenoh.open(router.client()))
    fleet = stack.enter_context(closing(Fleet(viewer)))
    tokens = [stranger.liveliness().declare_token(f"hyperbit/{name}/alive") for name in ("x", "y")]
    awaited(fleet, lambda found: len(living(found)) == 2)
    queryable = stranger.declare_queryable("**/hyperbit/**", lambda query: query.reply(str(query.key_expr), b"5"))
    for token in tokens:
        token.undeclare()
    awaited(fleet, lambda found: not living(found))
    arm = PlayedArm(stack, router.client())
    for prefix in (HERE.prefix, "hyperbit/x"):
        intrude(stranger, prefix)
    awaited(fleet, lambda found: living(found) == {HERE})
    assert stop_all(viewer, timeout=PATIENCE).answers[HERE].message == "stopped"
    assert "stop" in arm.commands()
    queryable.undeclare()  # type: ignore[no-untyped-call]


def test_an_arm_without_an_answer_is_named(stack: ExitStack, router: Router, viewer: zenoh.Session) -> None:
    silent, refusing = PlayedArm(stack, router.client("cell1")), PlayedArm(stack, router.client())
    silent.answer, refusing.answer = None, {"accepted": False, "code": -1, "message": "no"}
    eventually(lambda: alive(viewer) == [HERE, THERE])
    report = stop_all(viewer, timeout=1.0)
    assert (report.silent, list(report.answers)) == ([THERE], [HERE])
    assert not report.complete
    assert len(silent.asked) > 1, "it was asked again by its name"


def test_an_arm_that_starts_during_a_stop_for_all_is_stopped(
    stack: ExitStack, router: Router, viewer: zenoh.Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, late = PlayedArm(stack, router.client()), list[PlayedArm]()
    eventually(lambda: alive(viewer) == [HERE])

    def looking(session: zenoh.Session, places: tuple[str, ...]) -> list[ArmAddress]:
        if not late:  # the wildcards were sent before
            eventually(lambda: first.asked)
            late.append(PlayedArm(stack, router.client("cell1")))
            eventually(lambda: alive(viewer) == [HERE, THERE])
        return alive(session, places)

    monkeypatch.setattr("hyperbit.controller.network.stop_all.alive", looking)
    assert stop_all(viewer, timeout=PATIENCE).answers.keys() == {HERE, THERE}
    assert late[0].commands() == ["stop"]


def test_without_an_arm_nothing_has_stopped(viewer: zenoh.Session) -> None:
    report = stop_all(viewer)
    assert report == ({}, [])
    assert not report.complete


@pytest.mark.parametrize("attempt", range(5))
def test_the_list_is_complete_at_once(stack: ExitStack, router: Router, attempt: int) -> None:
    arms = {address: PlayedArm(stack, router.client(address.namespace)) for address in (HERE, THERE, DEEP)}
    with zenoh.open(router.client()) as first:
        eventually(lambda: alive(first) == sorted(arms))
    with zenoh.open(router.client()) as viewer, closing(Fleet(viewer, alive(viewer, timeout=PATIENCE))) as fleet:
        assert living({it.address: it for it in fleet.wait_for_states(0.0)}) == arms.keys()


def test_an_arm_whose_computer_answers_late_is_listed():
    endpoint = free_endpoint()
    arm = subprocess.Popen([sys.executable, "-c", ARM, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert arm.stdin is not None
    assert arm.stdout is not None
    resumed = threading.Timer(3.0, os.kill, (arm.pid, signal.SIGCONT))
    with arm, arm.stdin:
        arm.stdout.readline()
        with zenoh.open(session.configuration("client", connect=endpoint)) as viewer:
            os.kill(arm.pid, signal.SIGSTOP)
            resumed.start()
            with closing(Fleet(viewer, alive(viewer, timeout=LIST_TIMEOUT))) as fleet:
                assert living({it.address: it for it in fleet.wait_for_states(0.0)}) == {HERE}
