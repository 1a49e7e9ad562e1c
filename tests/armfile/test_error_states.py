"""`error_state: off` in the arm's file: right where outputs that go off do what `on_loss` asks."""

from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.drivers.canopen.layout import lay_out
from tests.armfile.test_kinds_of_actuators import BISTABLE, DOUBLE, loaded, with_boards, with_node

INVERTED = {"bit": 0, "inverted": True}
OFF = [  # an actuator, `on_loss`, and what is wrong and needed where its outputs go off without the master
    ({}, "contract", None),
    (
        {},
        "hold",
        "is to hold (on_loss), and would contract when its outputs go off; on_loss: contract is needed, or a b",
    ),
    (
        {"output": INVERTED},
        "contract",
        "is to contract (on_loss), and would extend when its outputs go off, for `outpu",
    ),
    (
        {"output": INVERTED},
        "hold",
        "is to hold (on_loss), and would extend when its outputs go off, for `output` is in",
    ),
    (DOUBLE, "hold", None),
    (
        DOUBLE,
        "contract",
        "is to contract (on_loss), and would stay where it is when both its outputs go off; on_loss: h",
    ),
    (BISTABLE, "hold", None),
    (
        {**DOUBLE, "output": INVERTED},
        "hold",
        "is to hold (on_loss), and would extend when its outputs go off, for `out",
    ),
    ({"output_off": {**INVERTED, "bit": 8}}, "contract", None),
    (
        {"output_off": {**INVERTED, "bit": 8}},
        "hold",
        "is to hold (on_loss), and would contract when its outputs go off",
    ),
    (
        {"output_off": {**INVERTED, "bit": 8}, "pulse": 0.05},
        "hold",
        "is to hold (on_loss), and would contract when its outputs go off; outputs that are not inverted are needed",
    ),
    (
        {"output": INVERTED, "output_off": {**INVERTED, "bit": 8}},
        "hold",
        "is to hold (on_loss), and would have both its outputs on, for both are inverted; outputs that are not inv",
    ),
]


@pytest.mark.parametrize(("actuator", "on_loss", "wrong"), OFF, ids=[f"{one} {loss}" for one, loss, _ in OFF])
def test_off_is_right_where_it_does_what_on_loss_asks(
    tmp_path: Path, actuator: dict[str, Any], on_loss: str, wrong: str | None
) -> None:
    value = with_node(actuator, error_state=False)
    value["actuators"][1:3] = [
        {**entry, "node": 2, "output": 8 + k, "input": 8 + k} for k, entry in enumerate(value["actuators"][1:3])
    ]
    value["boards"]["on_loss"] = on_loss
    if wrong is None:
        arm = loaded(tmp_path, value)
        assert lay_out(arm.wiring).boards[0].loss_is_off
        return
    with pytest.raises(InputFaults) as caught:
        loaded(tmp_path, value)
    (fault,) = caught.value.faults
    assert fault.startswith(f"boards.nodes[1].error_state: off, but actuator 1.left {wrong}")


def test_a_whole_arm_of_plain_outputs_may_be_on_boards_that_switch_off(tmp_path: Path) -> None:
    arm = loaded(tmp_path, with_boards(error_state=False, on_loss="contract"))
    assert arm.wiring.error_state == "off"
    assert all(board.loss_is_off for board in lay_out(arm.wiring).boards)


def test_one_sentence_names_all_actuators_that_an_error_state_does_not_serve(tmp_path: Path) -> None:
    value = with_node({}, error_state=None)
    value["boards"] |= {"on_loss": "contract", "error_state": "device", "nodes": []}
    with pytest.raises(InputFaults) as caught:
        loaded(tmp_path, value)
    [fault] = caught.value.faults
    labels = ", ".join(f"{one['module']}.{one['actuator']}" for one in value["actuators"])
    assert fault.startswith(f"boards.error_state: device, but each of the actuators {labels} is to contract (on_loss)")
