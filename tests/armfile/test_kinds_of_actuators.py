"""The arm's file: kinds of actuators and what is said of single boards."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.executor.arm.arm import ExecutedArm, read_arm
from hyperbit.drivers.canopen.wiring import (
    BoardId,
    BoardLine,
    BusWiring,
    Channel,
    Interlock,
    NodeWiring,
    Wiring,
)
from tests.arm_files import document

DOUBLE = {"output_off": 8}
BISTABLE = {"output_off": 8, "pulse": 0.05}


def with_actuator(**fields: Any) -> dict[str, Any]:
    value = document()
    value["actuators"][0].update(fields)
    return value


def with_boards(actuator: dict[str, Any] | None = None, **fields: Any) -> dict[str, Any]:
    value = with_actuator(**(actuator or {}))
    value["boards"].update(fields)
    return value


def with_node(actuator: dict[str, Any] | None = None, **fields: Any) -> dict[str, Any]:
    return with_boards(actuator, nodes=[{"bus": "can0", "node": 1, **fields}])


def loaded(folder: Path, value: dict[str, Any]) -> ExecutedArm:
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(value))
    return read_arm(path)


# What is wrong with a file, and the beginning of the one fault that says so.
FAULTS = [
    (with_actuator(output_off=0), "actuators[1].output_off: output 0 of can0/1 is 1.left's already"),
    (with_actuator(output_off={"bit": 1}), "actuators[2].output: output 1 of can0/1 is 1.left's already"),
    (with_actuator(input_contracted=0), "actuators[1].input_contracted: input 0 of can0/1 is 1.left's already"),
    (
        with_actuator(output={"bit": 0, "invert": True}),
        "actuators[1].output.invert: unknown field; did you mean 'inverted'?",
    ),
    (with_actuator(input={"inverted": True}), "actuators[1].input.bit: required, but missing"),
    (with_actuator(input={"bit": 0, "inverted": 1}), "actuators[1].input.inverted: Expected `bool`, got `int`"),
    (
        with_actuator(input={"bit": 0, "board": "can0-9"}),
        "actuators[1].input.board: 'can0-9', but a bus and a node id from 1 to 126 are needed, as can0/9",
    ),
    (
        with_actuator(input_contracted={"bit": 0, "board": "can0/127"}),
        "actuators[1].input_contracted.board: 'can0/127', but a bus and a node id from 1 to 126 are needed, as can0/9",
    ),
    (
        with_actuator(input={"bit": 0, "board": "can7/9"}),
        "actuators[1].input.board: 'can7/9', but 'can7' is none of the buses can0, spare",
    ),
    (with_actuator(input={"bit": 1, "board": "can0/2"}), "actuators[5].input: input 1 of can0/2 is 1.left's already"),
    (
        with_actuator(input_contracted={"bit": 0, "board": "can0/1"}),
        "actuators[1].input_contracted: input 0 of can0/1 is 1.left's already",
    ),
    (
        with_actuator(input={"bit": 2032, "board": "can0/9"}),
        "actuators[1].input.bit: Expected `int` <= 2031 (given: 20",
    ),
    (with_actuator(input={"bit": 0, "board": 9}), "actuators[1].input.board: Expected `str | null`, got `int`"),
    (
        with_actuator(output={"bit": 0, "board": "can0/9"}),
        "actuators[1].output.board: unknown field; known are bit, in",
    ),
    (with_actuator(output="0"), "actuators[1].output: Expected `int | object`, got `str` (given: '0')"),
    (with_actuator(pulse=0.05), "actuators[1].pulse: 0.05 s, but an actuator without `output_off` returns when its"),
    (with_actuator(output_off=8, pulse=0), "actuators[1].pulse: Expected `float` >= 0.01 (given: 0)"),
    (with_actuator(output_off=8, pulse=11), "actuators[1].pulse: Expected `float` <= 10.0 (given: 11)"),
    (
        with_actuator(**BISTABLE, on_loss="contract"),
        "actuators[1].on_loss: contract, but the outputs of actuator 1.left are off between pulses, so it stays where",
    ),
    (
        with_boards(BISTABLE, on_loss="contract"),
        "boards.on_loss: contract, but the outputs of actuator 1.left are off between pulses, so it stays where it is;"
        " this actuator needs its own on_loss: hold",
    ),
    (with_actuator(on_loss="extend"), "actuators[1].on_loss: 'extend' is unknown"),
    (with_actuator(travel_time=0), "actuators[1].travel_time: Expected `float` > 0.0 (given: 0)"),
    (with_actuator(travel_time={"extend": 0.1}), "actuators[1].travel_time.contract: required, but missing"),
    (
        {**document(), "travel_time": {"extend": 1, "contract": 1, "retract": 1}},
        "travel_time.retract: unknown field; did you mean 'contract'? Known",
    ),
    (with_actuator(settle_margin=-1), "actuators[1].settle_margin: Expected `float` >= 0.0 (given: -1)"),
    ({**document(), "on_stop": "extend"}, "on_stop: 'extend' is unknown"),
    (with_boards(error_state="drop"), "boards.error_state: 'drop' is unknown"),
    (with_boards(error_state=True), "boards.error_state: true, but off, hold or device is needed"),
    (
        with_boards(nodes=[{"bus": "can0", "node": 1}, {"bus": "can0", "node": 1}]),
        "boards.nodes[2]: board can0/1 is there already; one entry a board is needed",
    ),
    (with_boards(nodes=[{"bus": "can7", "node": 1}]), "boards.nodes[1].bus: 'can7' is none of the buses can0, spare"),
    (
        with_boards(nodes=[{"bus": "can0", "node": 7}]),
        "boards.nodes[1].node: board can0/7 has no output, end-stop or interlock",
    ),
    (with_node(object=0x6000), "boards.nodes[1].object: 0x6000, but 0x6200 or an object from 0x2000 to 0x5fff is need"),
    (with_node(object=0x6300), "boards.nodes[1].object: Expected `int` <= 25088 (given: 25344)"),
    (with_node(serial=-1), "boards.nodes[1].serial: Expected `int` >= 0 (given: -1)"),
    (with_node(error_state=True), "boards.nodes[1].error_state: true, but off, hold or device is needed"),
    (
        with_node({"on_loss": "contract"}, error_state="hold"),
        "boards.nodes[1].error_state: hold, but actuator 1.left is to contract (on_loss), which `hold` does not ensure;"
        " off is needed, or a board with 6206h and 6207h, without error_state",
    ),
    (
        with_node(BISTABLE, error_state="device"),
        "boards.nodes[1].error_state: device, but actuator 1.left has pulses: an output that is on then would stay on",
    ),
]


@pytest.mark.parametrize(("value", "beginning"), FAULTS, ids=[fault[:40] for _, fault in FAULTS])
def test_each_fault_names_field_value_and_need(tmp_path: Path, value: dict[str, Any], beginning: str) -> None:
    with pytest.raises(InputFaults) as caught:
        loaded(tmp_path, value)
    (fault,) = caught.value.faults
    assert fault.startswith(beginning)


def test_end_stops_may_be_on_boards_without_outputs_and_on_other_buses(tmp_path: Path) -> None:
    value = with_actuator(
        input={"board": "can0/9", "bit": 3, "inverted": True}, input_contracted={"board": "spare/1", "bit": 40}
    )
    value["actuators"][1]["input"] = {"bit": 1, "board": "can0/1"}  # that of its output
    value["boards"]["nodes"] = [{"bus": "can0", "node": 9, "serial": 7}]
    wiring = loaded(tmp_path, value).wiring
    first, second, *_ = wiring.channels
    assert first.lines == {
        "output": BoardLine("can0", 1, 0),
        "input": BoardLine("can0", 9, 3, inverted=True),
        "input_contracted": BoardLine("spare", 1, 40),
    }
    assert (first.input_board, first.input_contracted_board) == (BoardId("can0", 9), BoardId("spare", 1))
    assert (second.line("input"), second.input_board) == (BoardLine("can0", 1, 1), None)
    assert [str(board) for board in wiring.boards] == ["can0/1", "can0/2", "can0/9", "spare/1"]


@pytest.mark.parametrize(
    ("field", "kind", "bytes_before", "extra"),
    [("output", "outputs", 32, 300), ("input", "inputs", 32, {"bit": 300, "board": "can0/1"})],
)
def test_process_data_that_do_not_fit_on_a_board_are_refused_with_the_field(
    tmp_path: Path, field: str, kind: str, bytes_before: int, extra: Any
) -> None:
    value = document(12)
    for k, entry in enumerate(value["actuators"]):
        entry.update(node=1, output=k, input=k)
    for k, entry in enumerate(value["actuators"][:bytes_before]):
        entry[field] = 8 * k
    for k, entry in enumerate(value["actuators"][bytes_before:]):
        entry[field] = 8 * k + 1
    loaded(tmp_path, value)
    value["actuators"][35][field] = extra
    with pytest.raises(InputFaults) as caught:
        loaded(tmp_path, value)
    assert caught.value.faults == (
        f"actuators[36].{field}: 300, but board can0/1: its {kind} are in 33 bytes; 32 fit in four PDOs",
    )


def test_all_that_can_be_said_of_an_actuator(tmp_path: Path) -> None:
    value = with_actuator(
        output={"bit": 0, "inverted": True},
        output_off=8,
        input={"bit": 0},
        input_contracted={"bit": 9, "inverted": True},
        pulse=0.05,
        travel_time={"extend": 0.1, "contract": 0.2},
        settle_margin=0.5,
    )
    value["actuators"][1].update(travel_time=0.3, on_loss="contract")
    value["boards"]["nodes"] = [{"bus": "can0", "node": 1, "object": 0x2201, "vendor": 0x21, "error_state": False}]
    value["boards"]["nodes"][0].pop("error_state")
    value |= {"on_stop": "contract", "interlocks": {"door": {"bus": "can0", "node": 9, "input": 3, "inverted": True}}}
    arm = loaded(tmp_path, value)
    first, second, third, *_ = arm.wiring.channels
    inverted = frozenset({"output", "input_contracted"})
    assert first == Channel("1.left", "can0", 1, 0, 0, 8, 9, inverted, 0.05, (0.2, 0.1), 0.5)
    assert second == Channel("1.diagonal", "can0", 1, 1, 1, travel=(0.3, 0.3), on_loss="contract")
    assert third == Channel("1.right", "can0", 1, 2, 2, travel=(0.05, 0.05))
    assert arm.wiring.nodes == (NodeWiring("can0", 1, object=0x2201, vendor=0x21),)
    assert arm.wiring.interlocks == (Interlock("door", "can0", 9, 3, inverted=True),)
    assert (arm.contract_on_stop, arm.timing.travel_time) == (True, 0.3)


def test_an_old_file_means_what_it_did(tmp_path: Path) -> None:
    arm = loaded(tmp_path, document())
    for k, channel in enumerate(arm.wiring.channels):
        old = Channel(arm.actuators[k], "can0", 1 + k // 3, k % 3, k % 3)
        assert channel == Channel(*(old.actuator, old.bus, old.node, old.output, old.input), travel=(0.05, 0.05))
    assert (arm.wiring.nodes, arm.wiring.interlocks, arm.contract_on_stop) == ((), (), False)
    assert arm.wiring.loss_levels == (None,) * 6
    assert not arm.wiring.paired + arm.wiring.ended


def test_lines_are_those_of_the_extending_side_then_the_others_then_interlocks() -> None:
    wiring = Wiring(
        buses=(BusWiring("can0", "virtual", "x"),),
        channels=(
            Channel("a", "can0", 1, 0, None, 1, 5, frozenset({"output_off"})),
            Channel("b", "can0", 1, 2, 3),
            Channel("c", "can0", 2, 7, 0, 6, pulse=0.05, on_loss="hold"),
        ),
        on_loss="contract",
        interlocks=(Interlock("air", "can0", 9, 4, inverted=True),),
    )
    one, other = ("can0", 1), ("can0", 2)
    assert wiring.output_lines == (
        *(BoardLine(*one, 0), BoardLine(*one, 2), BoardLine(*other, 7)),
        *(BoardLine(*one, 1, inverted=True), BoardLine(*other, 6)),
    )
    assert wiring.input_lines == (
        None,
        BoardLine(*one, 3),
        BoardLine(*other, 0),
        BoardLine(*one, 5),
        BoardLine("can0", 9, 4, True),
    )
    assert wiring.loss_levels == (0, 0, 0, 1, 0)
    assert (wiring.paired, wiring.ended) == ((0, 2), (0,))


bits = st.integers(0, 40) | st.builds(
    lambda bit, inverted: {"bit": bit, "inverted": inverted}, *[st.integers(0, 40), st.booleans()]
)
elsewhere = st.builds(
    lambda bit, board: {"bit": bit, "board": board},
    *[st.integers(0, 40), st.sampled_from(["can0/1", "can0/9", "spare/1", "can7/1", "x"])],
)
times = st.floats(0.01, 1) | st.fixed_dictionaries({"extend": st.floats(0.01, 1), "contract": st.floats(0.01, 1)})
entries = st.fixed_dictionaries(
    {"output": bits},
    optional={
        "output_off": bits,
        "pulse": st.floats(0.01, 1),
        "input": bits | elsewhere,
        "input_contracted": bits | elsewhere,
        "travel_time": times,
        "settle_margin": st.floats(0, 1),
        "on_loss": st.sampled_from(["hold", "contract"]),
    },
)


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    entries=st.lists(entries, min_size=6, max_size=6),
    on_loss=st.sampled_from(["hold", "contract"]),
    state=st.sampled_from([None, False, "hold", "device"]),
    lock=bits,
)
def test_a_file_either_loads_into_a_wiring_or_says_why_not(
    tmp_path: Path, entries: list[dict[str, Any]], on_loss: str, state: Any, lock: Any
) -> None:
    value = with_boards(on_loss=on_loss, error_state=state)
    value["actuators"] = [
        {"module": 1 + k // 3, "actuator": old["actuator"], "bus": "can0", "node": 1 + k, **new}
        for k, (old, new) in enumerate(zip(value["actuators"], entries, strict=True))
    ]
    input = lock if isinstance(lock, int) else lock["bit"]
    value["interlocks"] = {"stop": {"bus": "can0", "node": 1, "input": input}}
    try:
        arm = loaded(tmp_path, value)
    except InputFaults:
        return
    wiring, pulsed = arm.wiring, [k for k, entry in enumerate(entries) if "pulse" in entry]
    assert len(wiring.output_lines) == 6 + len(wiring.paired) == len(wiring.loss_levels)
    assert len(wiring.input_lines) == 6 + len(wiring.ended) + 1
    assert set(pulsed) <= set(wiring.paired)
    for place, k in enumerate(wiring.paired):
        levels = wiring.loss_levels[k], wiring.loss_levels[6 + place]
        assert levels in ((None, None), (0, 1), (0, 0))
        assert (levels == (0, 0)) == (k in pulsed)
    assert arm.timing.travel_time == max(max(channel.travel or ()) for channel in wiring.channels)


@pytest.mark.parametrize(
    ("on_stop", "inrush", "expected"), [("hold", 4, 0.0), ("contract", 4, 5 * 0.68), ("contract", 1, 13 * 0.68)]
)
def test_the_end_takes_as_long_as_all_stages(tmp_path: Path, on_stop: str, inrush: int, expected: float) -> None:
    arm = loaded(tmp_path, {**document(), "on_stop": on_stop, "inrush": inrush})
    assert arm.ending == pytest.approx(expected), "travel 0.05, margin 0.03, rest 0.5, and 0.1 s to spare"
