"""Metrics for Prometheus, checked by its own parser, also without fields of messages."""

from dataclasses import dataclass, field
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from starlette.applications import Starlette
from starlette.routing import Route
from starlette.testclient import TestClient

from hyperbit.controller.decoding.decoding import convert
from hyperbit.controller.messages.goals import Result
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.panel.arms.metrics import (
    MOST_ACTUATORS,
    MOST_KINDS,
    STATUSES,
    Counters,
    endpoint,
    exposition,
)

FAULT = {"code": "board-lost", "source": "can0/3", "message": 'board "can0/3"\nis lost'}
STATE = {"mode": "fault", "faults": [FAULT, FAULT], "degraded": [{"actuator": "5.left", "state": 0}]}
DIAGNOSTICS = {
    "loop": {"late_p50": 0.0001, "late_p99": 0.004, "late_worst": 0.005, "overruns": 2.0},
    "buses": [
        {
            **{"name": "can0", "state": "active", "load": 0.25, "worst_case": {"load": 0.5}, "dropped": 0},
            **{"tx_frames": 10, "rx_frames": 20, "tx_errors": 0, "rx_errors": 1},
        }
    ],
    "boards": [
        {"bus": "can0", "node": 1, "state": "operational", "emergency": None, "heartbeat_age": 0.02},
        {"bus": "can0", "node": 3, "state": "lost", "emergency": None},
    ],
    "queues": {"inbox": 1, "planning": 0},
    "setpoint": {"received": 5, "refused": 1},
    "counts": [3, 4],
    "waits": 7,
}


@dataclass
class Arm:
    name: str = "a"
    alive: bool = True
    state: State | None = None
    diagnostics: Diagnostics | None = None
    actuators: list[str] = field(default_factory=list)


def told(
    state: dict[str, Any] = STATE, diagnostics: dict[str, Any] = DIAGNOSTICS, labels: str = "1.left 1.right"
) -> Arm:
    return Arm("a", True, convert(state, State), convert(diagnostics, Diagnostics), labels.split())


def read(*arms: Arm, counters: Counters | None = None) -> dict[tuple[str, ...], float]:
    """Returns the metrics by name and label values; labels are in alphabetical order."""
    text = exposition(arms, counters or Counters()).decode()
    samples = [sample for family in text_string_to_metric_families(text) for sample in family.samples]
    return {(sample.name, *sample.labels.values()): sample.value for sample in samples}


def test_counters_begin_with_0_before_the_first_event() -> None:
    found = read(Arm())
    assert found["hyperbit_goals_total", "a", "succeeded"] == found["hyperbit_goals_total", "a", "aborted"] == 0.0
    assert found["hyperbit_faults_total", "a", "board-lost"] == 0.0


def test_metrics_agree_with_the_messages_of_arms() -> None:
    counters = Counters()
    for status in ("succeeded", "succeeded", "aborted"):
        counters.result("a", Result(status))
    for state in (STATE, STATE, {"mode": "ready"}, STATE):
        counters.state("a", convert(state, State))
    found = read(told(), Arm("b", False), counters=counters)
    expected = {
        ("hyperbit_goals_total", "a", "succeeded"): 2,
        ("hyperbit_goals_total", "a", "aborted"): 1,
        ("hyperbit_faults_total", "a", "board-lost"): 2,
        ("hyperbit_alive", "a"): 1,
        ("hyperbit_alive", "b"): 0,
        ("hyperbit_mode", "a", "fault"): 1,
        ("hyperbit_mode", "a", "ready"): 0,
        ("hyperbit_fault_active", "a", "board-lost", "can0/3"): 1,
        ("hyperbit_actuators_locked", "a"): 1,
        ("hyperbit_switches_total", "1.left", "a"): 3,
        ("hyperbit_switches_total", "1.right", "a"): 4,
        ("hyperbit_arm_switches_total", "a"): 7,
        ("hyperbit_cycle_late_seconds", "a", "0.99"): 0.004,
        ("hyperbit_cycle_overruns", "a"): 2,
        ("hyperbit_bus_load_ratio", "a", "can0"): 0.25,
        ("hyperbit_bus_frames_total", "a", "can0", "rx"): 20,
        ("hyperbit_bus_errors", "a", "can0", "rx"): 1,
        ("hyperbit_board_heartbeat_age_seconds", "a", "can0/1"): 0.02,
        ("hyperbit_board_operational", "a", "can0/1"): 1,
        ("hyperbit_board_operational", "a", "can0/3"): 0,
        ("hyperbit_queue_length", "a", "inbox"): 1,
        ("hyperbit_setpoints_total", "a", "refused"): 1,
        ("hyperbit_clearance_waits_total", "a"): 7,
    }
    assert {key: found.get(key) for key in expected} == expected
    assert ("hyperbit_board_heartbeat_age_seconds", "a", "can0/3") not in found
    counted = ("hyperbit_alive", "hyperbit_goals_total", "hyperbit_faults_total")
    assert not [key for key in found if "b" in key[1:] and key[0] not in counted]
    assert any(name == "hyperbit_build_info" for name, *_ in found)


@pytest.mark.parametrize("absent", ["faults", *DIAGNOSTICS])
def test_a_field_that_an_arm_does_not_send_leaves_its_figures_out(absent: str) -> None:
    less = [{name: value for name, value in own.items() if name != absent} for own in (STATE, DIAGNOSTICS)]
    found = read(told(*less))
    assert len(found) < len(read(told()))


def test_few_series() -> None:
    counters, many = Counters(), MOST_ACTUATORS + 1
    for k in range(3 * MOST_KINDS):
        counters.result("a", Result(f"status {k}"))
    found = read(told(STATE, {"counts": [1] * many}, " ".join(map(str, range(many)))), counters=counters)
    assert sum(key[0] == "hyperbit_goals_total" for key in found) == len(STATUSES) + MOST_KINDS + 1
    assert sum(key[0] == "hyperbit_switches_total" for key in found) == 0
    assert found["hyperbit_arm_switches_total", "a"] == many


def test_the_route_answers_in_prometheus_format() -> None:
    arms = [told()]
    app = Starlette(routes=[Route("/metrics", endpoint(lambda: arms, Counters()))])
    answer = TestClient(app).get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=")
    assert 'hyperbit_fault_active{arm="a",code="board-lost",source="can0/3"} 1.0' in answer.text
