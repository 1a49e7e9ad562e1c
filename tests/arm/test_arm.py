"""The arm that is built from a file."""

import math
from dataclasses import replace

import msgspec
import pytest
from numpy.testing import assert_allclose

from hyperbit.controller.arm.weights import weights_of
from hyperbit.controller.armfile.settings import WeightSettings
from hyperbit.controller.manipulator import frames
from hyperbit.controller.obstacles.obstacles import sphere
from tests.arm_files import changed, document, listed


def test_the_papers_arm(arm):
    assert arm.manipulator.states.tolist() == [8] * 16
    assert len(arm.wiring) == len(arm.manipulator.actuators) == 48
    assert (arm.pixel, arm.level_pixels, arm.tolerance) == (0.01, 524_288, 0.002)
    assert arm.wiring[47].node == 16


def test_the_valid_document_is_valid(read):
    arm = read(document())
    assert arm.settings.buses[0].bitrate == 500_000
    assert_allclose(arm.manipulator.base, frames.planar(0.5, 0.25, 0.1))


def test_wiring_follows_the_manipulators_actuators_not_the_file(read):
    value = document()
    value["actuators"].reverse()
    wiring = read(value).wiring
    assert [f"{w.module}.{w.actuator}" for w in wiring] == list(read(value).manipulator.actuators)


def test_much_can_be_left_out(read):
    arm = read(
        {"name": "a", "modules": [{"type": "vgt", "width": 1, "lengths": [1, 1.2]}], "tolerance": {"position": 1}}
    )
    assert arm.wiring == ()
    assert arm.pixel == arm.manipulator.length / 400
    assert (arm.settings.method, arm.settings.boards.heartbeat) == ("minimum-switch", 0.1)


def test_diagonals_alternate_and_legs_may_differ(read):
    legs = {"left": [0.2, 0.25], "diagonal": [0.21, 0.26], "right": [0.19, 0.24]}
    truss = {"type": "vgt", "count": 3, "width": 0.2, "lengths": legs, "first_diagonal": "AD"}
    value = {"name": "a", "modules": [truss], "tolerance": {"position": 1}}
    first, second, third = read(value).manipulator.modules
    assert_allclose(first.frames, third.frames)
    truss["first_diagonal"] = "BC"
    assert_allclose(second.frames, read(value).manipulator.modules[0].frames)


def test_listed_frames_planar_and_spatial(read):
    flat = listed({"position": [0, 1]}, {"position": [0, 1], "orientation": 0.5}, {"position": [0, 2]}, count=2)
    value = {"name": "a", "modules": flat, "tolerance": {"position": 1}}
    assert read(value).manipulator.dimension == 2
    assert read(value).manipulator.actuators == ("1.1", "1.2", "2.1", "2.2")
    value["modules"] = listed({"position": [0, 0, 1]}, {"position": [0, 1], "orientation": [0, 0, 0.6, 0.8]})
    manipulator = read(value).manipulator
    assert manipulator.dimension == 3
    assert_allclose(manipulator.frames[0, 1], frames.spatial((0, 1, 0), (0, 0, 0.6, 0.8)))


def test_settings_go_back_to_the_same_arm(read, arm):
    sent = msgspec.json.decode(msgspec.json.encode(msgspec.to_builtins(arm.settings)))
    assert read(sent).settings == arm.settings


def test_one_actuator_may_have_no_input_and_share_a_bit_number_on_another_board(read):
    value = changed("actuators.0.input", None)
    del value["actuators"][1]["input"]
    assert [entry.input for entry in read(value).wiring] == [None, None, 2, 0, 1, 2]


def test_weights_fall_from_base_to_tip_and_grow_with_wear(arm):
    assert weights_of(arm).tolist() == [1.0] * 48
    settings = msgspec.structs.replace(arm.settings, weights=WeightSettings(base=4.0, wear=0.5))
    heavy = [msgspec.structs.replace(entry, weight=2.0 if k == 7 else 1.0) for k, entry in enumerate(arm.wiring)]
    weighted = replace(arm, settings=settings, wiring=tuple(heavy))
    plain = weights_of(weighted)
    assert plain[0] == plain[2] == 4.0
    assert plain[-1] == 1.0
    assert plain[7] == pytest.approx(2 * plain[6])
    worn = weights_of(weighted, {"1.left": 10, "1.right": 5, "no.such": 99})
    assert worn[:3] / plain[:3] == pytest.approx([1.5, 1.0, 1.25])
    assert worn[3:].tolist() == plain[3:].tolist()


def test_actuators_that_are_stuck_leave_their_modules_fewer_states(read):
    value = changed("actuators.1.stuck", "extended")
    value["actuators"][5]["stuck"] = "contracted"
    arm = read(value)
    assert arm.locked.tolist() == [-1, 1, -1, -1, -1, 0]
    assert (arm.manipulator.states.tolist(), arm.reduced.states.tolist()) == ([8, 8], [4, 4])
    assert set(arm.reduced.modules[0].bits[:, 1]) == {1}
    assert read(document()).reduced.states.tolist() == [8, 8]


def test_regions_are_those_of_the_file_and_others_beside_them(read):
    arm = read(document())
    assert arm.obstacles.names == ("disc 'pillar'", "box obstacles[1]", "half-plane 'floor'")
    points = [[2.4, 2, 0], [-1, 1, 0], [7, -0.25, 0], [-1.0 + 0.3 * math.cos(0.5), 1.0 + 0.3 * math.sin(0.5), 0]]
    expected = [[0.1, None, 2.2], [None, -0.1, 1.2], [None, None, -0.05], [None, 0.1, None]]
    for depths, wanted in zip(arm.obstacles.depths(points), expected, strict=True):
        assert [d for d, w in zip(depths, wanted, strict=True) if w is not None] == pytest.approx(
            [w for w in wanted if w is not None]
        )
    clearance = arm.clearance(others=sphere("disc 'guest'", [0, 3], 0.1))
    assert clearance.obstacles.names[3:] == ("disc 'guest'",)
    assert (clearance.radius, clearance.self_collision) == (0.02, True)


def test_nothing_is_to_be_avoided_where_the_file_says_nothing(arm):
    assert arm.clearance().free
    assert arm.clearance().radius == 0


def test_boxes_in_space_are_turned_by_a_quaternion(read):
    states = listed({"position": [0, 0, 1]}, {"position": [0, 1, 1]})
    upright = {"centre": [0, 0, 5], "size": [2, 0.2, 0.2], "orientation": [0, 0.5**0.5, 0, 0.5**0.5]}
    value = {"name": "a", "modules": states, "tolerance": {"position": 1}, "obstacles": [{"box": upright}]}
    obstacles = read(value).obstacles
    assert obstacles.depths([[0, 0, 5.9], [0.9, 0, 5]])[:, 0] == pytest.approx([-0.1, 0.8])
