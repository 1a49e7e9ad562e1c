"""The command `ros2`: unusable words, and two bridges of one name."""

from __future__ import annotations

import time
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hyperbit.controller.commands.serve import ros2
from hyperbit.controller.ros2.arm_node import ROSOUT, Settings
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.commands.conftest import Told
from tests.network.played import Router
from tests.waiting import PATIENCE, eventually

SETTINGS = Settings("", 0, "jazzy", "world", oriented=False)


@pytest.fixture
def router(stack: ExitStack) -> Router:
    return Router(stack)


@pytest.mark.parametrize("distro", ["noetic", ""])
def test_an_unknown_distribution_is_refused_with_the_known_ones(told: Told, distro: str) -> None:
    words = told("ros2", "planar16", "--distro", distro, code=2)
    assert "--distro" in words
    assert all(name in words for name in ("jazzy", "kilted", "lyrical"))


def test_humble_is_refused_with_the_reason(told: Told) -> None:
    assert "its rmw_zenoh has no type hashes in keys" in told("ros2", "planar16", "--distro", "humble", code=2)


@pytest.mark.parametrize("namespace", ["arm", "/arm/", "/1arm", "/a b"])
def test_a_namespace_that_ros_2_does_not_allow_is_refused(told: Told, namespace: str) -> None:
    assert "--namespace" in told("ros2", "planar16", "--namespace", namespace, code=2)


def test_a_second_bridge_of_one_name_is_refused_in_words(
    told: Told, router: Router, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros2, "GONE_WITHIN", 0.0)
    said: list[str] = []
    with Session(router.endpoint, PATIENCE) as session:
        other = Node(session, "hyperbit", "/planar16")
        other.subscriber("/rosout", "rcl_interfaces/msg/Log", lambda it: said.append(it.message.msg), ROSOUT)
        words = told("ros2", "planar16", "--connect", router.endpoint, "--ros", router.endpoint, code=1)
        assert "another node /planar16/hyperbit is there on domain 0" in words
        assert "--namespace" in words
        eventually(lambda: any("two bridges of one name" in it for it in said))


def test_a_bridge_waits_for_the_end_of_the_one_before(router: Router) -> None:
    """The token of a bridge that was killed stays for a while."""
    with Session(router.endpoint, PATIENCE) as session, Session(router.endpoint, PATIENCE) as own:
        other = Node(session, "hyperbit", "/planar16")
        eventually(own.tokens)
        ends = iter([other.close])  # its token may be seen a few times more
        process: Any = SimpleNamespace(wait=lambda: next(ends, lambda: time.sleep(0.05))())
        ros2.check_alone(own, "planar16", SETTINGS, cast("Any", process))
        assert own.tokens() == []


def test_a_namesake_of_another_namespace_or_domain_is_no_second_bridge(router: Router) -> None:
    def never() -> None:
        raise AssertionError("the bridge waits")

    with Session(router.endpoint, PATIENCE) as session, Session(router.endpoint, PATIENCE) as own:
        nodes = [Node(session, "hyperbit", "/other"), Node(session, "hyperbit", "/planar16", domain=7)]
        eventually(lambda: own.tokens(0) and own.tokens(7))
        process: Any = SimpleNamespace(wait=never)
        ros2.check_alone(own, "planar16", SETTINGS, process)
        assert len(nodes) == 2
