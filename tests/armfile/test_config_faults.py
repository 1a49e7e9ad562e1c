"""The arm's file: every fault in it by the path of its field."""

import copy
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.strict import InputFaults
from tests.arm_files import LABELS, TRUSS, changed, document, listed


def faults(read, value) -> list[str]:
    with pytest.raises(InputFaults) as caught:
        read(value)
    return list(caught.value.faults)


# Field set, value given, the one fault it must bring, by its beginning.
FAULTS = [
    ("nam", "x", "nam: unknown field; did you mean 'name'? Known are actuators, base, boards"),
    ("boards.hartbeat", 1, "boards.hartbeat: unknown field; did you mean 'heartbeat'? Known are boot_timeout"),
    ("actuators.1.nod", 1, "actuators[2].nod: unknown field"),
    ("name", 7, "name: Expected `str`, got `int` (given: 7)"),
    ("name", "a b", "name: Expected `str` of 1 to 64 letters, digits, _ and -"),
    ("name", "a\n", "name: Expected `str` of 1 to 64 letters, digits, _ and -"),
    ("name", "", "name: Expected `str` of 1 to 64 letters, digits, _ and -"),
    ("name", "a/b", "name: Expected `str` of 1 to 64 letters, digits, _ and -"),
    ("modules", [], "modules: Expected `array` of length >= 1 (given: [])"),
    ("modules.0.type", "vgd", "modules[1].type: 'vgd' is unknown; did you mean 'vgt'? It must be one of vgt, revolute"),
    ("modules.0.count", 0, "modules[1].count: Expected `int` >= 1 (given: 0)"),
    ("modules.0.count", 10_001, "modules[1].count: Expected `int` <= 10000 (given: 10001)"),
    ("modules.0.count", 2.5, "modules[1].count: Expected `int`, got `float` (given: 2.5)"),
    ("modules.0.width", -0.2, "modules[1].width: Expected `float` > 0.0 (given: -0.2)"),
    ("modules.0.width", math.nan, "modules[1].width: nan is not a finite number"),
    ("modules.0.width", 10**400, "modules[1].width: Number out of range (given: 1000"),
    ("modules.0.lengths", [0.2], "modules[1].lengths: Expected `array` of length 2, got 1"),
    ("modules.0.lengths", [0.2, math.inf], "modules[1].lengths[2]: inf is not a finite number"),
    ("modules.0.lengths", [0.2, 1.1e200], "modules[1].lengths[2]: Expected `float` <= 1000000.0"),
    ("modules.0.lengths", {"left": [1, 2], "right": [1, 2]}, "modules[1].lengths.diagonal: required, but missing"),
    ("modules.0.first_diagonal", "CB", "modules[1].first_diagonal: 'CB' is unknown"),
    ("modules.0.width", 0.9, "modules[1].lengths: legs 0.2 and 0.2, diagonal 0.2, width 0.9: sides 0.2 and 0.2"),
    ("tolerance", {}, "tolerance.position: required, but missing"),
    ("tolerance.position", 0, "tolerance.position: Expected `float` > 0.0 (given: 0)"),
    ("travel_time", 61, "travel_time: Expected `float` <= 60.0 (given: 61)"),
    ("rest_time", -0.1, "rest_time: Expected `float` >= 0.0 (given: -0.1)"),
    ("inrush", 0, "inrush: Expected `int` >= 1 (given: 0)"),
    ("inrush", 2.5, "inrush: Expected `int"),
    ("base.position", [1], "base.position: Expected `array` of length >= 2 (given: [1])"),
    ("base.position", [1, math.nan], "base.position[2]: nan is not a finite number"),
    ("base.position", [1e300, 0], "base.position[1]: Expected `float` <= 1000000.0"),
    ("base.orientation", [0, 0, 1], "base.orientation: Expected `array` of length >= 4 (given: [0, 0, 1])"),
    ("base.orientation", [0, 0, 1, 1], "base.orientation: a quaternion x, y, z, w of length 1 is needed, got"),
    ("base.position", [0, 0, 1], "base.orientation: a spatial frame needs a quaternion x, y, z, w, got the angle 0.1"),
    ("workspace.pixel", 0, "workspace.pixel: Expected `float` > 0.0 (given: 0)"),
    ("workspace.memory", 70000, "workspace.memory: Expected `float` <= 65536.0 (given: 70000)"),
    ("method", "ipop", "method: 'ipop' is unknown"),
    ("planning", {"seconds_per_switch": -0.1}, "planning.seconds_per_switch: Expected `float` >= 0.0 (given: -0.1)"),
    ("planning", {"seconds_per_switch": 61}, "planning.seconds_per_switch: Expected `float` <= 60.0 (given: 61)"),
    ("boards.heartbeat", 0.01, "boards.heartbeat: Expected `float` >= 0.02 (given: 0.01)"),
    (
        "boards.heartbeat_timeout",
        0.15,
        "boards.heartbeat_timeout: 0.15 s is too short for heartbeats every 0.1 s; more",
    ),
    ("boards.on_loss", "extend", "boards.on_loss: 'extend' is unknown"),
    ("buses.0.bitrate", 2_000_000, "buses[1].bitrate: Expected `int` <= 1000000 (given: 2000000)"),
    ("buses.0.interface", "serial", "buses[1].interface: 'serial' is unknown"),
    ("buses.1.channel", "can0", "buses[2].channel: 'can0' is the channel of can0; each bus needs its own"),
    ("buses.1.name", "can0", "buses[2].name: 'can0' is already taken"),
    ("actuators.0.node", 127, "actuators[1].node: Expected `int` <= 126 (given: 127)"),
    ("actuators.0.node", 0, "actuators[1].node: Expected `int` >= 1 (given: 0)"),
    ("actuators.0.output", 2032, "actuators[1].output: Expected `int` <= 2031 (given: 2032)"),
    ("actuators.0.input", -1, "actuators[1].input: Expected `int` >= 0 (given: -1)"),
    ("actuators.0.bus", "can7", "actuators[1].bus: 'can7' is none of the buses can0, spare"),
    ("actuators.1.output", 0, "actuators[2].output: output 0 of can0/1 is 1.left's already"),
    ("actuators.1.input", 0, "actuators[2].input: input 0 of can0/1 is 1.left's already"),
    ("actuators.0.stuck", "yes", "actuators[1].stuck: 'yes' is unknown"),
    ("on_stuck", "go", "on_stuck: 'go' is unknown"),
    ("actuators.0.module", 0, "actuators[1].module: Expected `int` >= 1 (given: 0)"),
    ("body_radius", -0.1, "body_radius: Expected `float` >= 0.0 (given: -0.1)"),
    ("self_collision", 1, "self_collision: Expected `bool`, got `int` (given: 1)"),
    ("obstacles", {}, "obstacles: Expected `array`, got `object`"),
    ("obstacles.0.disk", 1, "obstacles[1].disk: unknown field; did you mean 'disc'? Known are box, disc, half_plane"),
    ("obstacles.0.disc.radius", -1, "obstacles[1].disc.radius: Expected `float` > 0.0 (given: -1)"),
    ("obstacles.0.disc.radius", math.inf, "obstacles[1].disc.radius: inf is not a finite number"),
    ("obstacles.0.disc.center", [0, 0], "obstacles[1].disc.center: unknown field; did you mean 'centre'?"),
    ("obstacles.0.disc.centre", [0, 0, 0], "obstacles[1].disc.centre: 3 coordinates, a planar arm's have 2"),
    ("obstacles.0.disc.centre", [1e9, 0], "obstacles[1].disc.centre[1]: Expected `float` <= 1000000.0"),
    ("obstacles.0.name", "a b", "obstacles[1].name: Expected `str` of 1 to 64 letters, digits, _ and -"),
    ("obstacles.2.name", "pillar", "obstacles[3].name: 'pillar' is the name of another obstacle already"),
    ("obstacles.1.box.size", [0.4, 0], "obstacles[2].box.size[2]: Expected `float` > 0.0 (given: 0)"),
    ("obstacles.1.box.size", [0.4, 1, 1], "obstacles[2].box.size: 3 coordinates, a planar arm's have 2"),
    ("obstacles.1.box.angle", 90, "obstacles[2].box.angle: Expected `float` <= 12.5664 (given: 90)"),
    ("obstacles.1.box.orientation", [0, 0, 0, 1], "obstacles[2].box.orientation: a box of the plane is turned by an"),
    ("obstacles.2.half_plane.normal", [0, 0], "obstacles[3].half_plane.normal: a direction is needed, got [0"),
    ("obstacles.1", {}, "obstacles[2]: one of disc, box, half_plane is needed for a planar arm, got none of them"),
    (
        "obstacles.1.disc",
        {"centre": [0, 0], "radius": 1},
        "obstacles[2]: one of disc, box, half_plane is needed for a planar arm, got disc and box",
    ),
    (
        "obstacles.1",
        {"sphere": {"centre": [0, 0], "radius": 1}},
        "obstacles[2]: one of disc, box, half_plane is needed for a planar arm, got sphere",
    ),
    ("obstacles", [{"disc": {"centre": [5, 5], "radius": 1}}] * 257, "obstacles: Expected `array` of length <= 256"),
    (
        "obstacles.0.disc",
        {"centre": [0.5, 0.35], "radius": 0.1},
        "obstacles: module 1 is in disc 'pillar' in every state; the arm could not move",
    ),
]


@pytest.mark.parametrize(("where", "value", "beginning"), FAULTS, ids=lambda value: str(value)[:30])
def test_each_fault_is_named_by_its_field(read, where, value, beginning):
    (fault,) = faults(read, changed(where, value))
    assert fault.startswith(beginning)


@pytest.mark.parametrize("field", ["name", "modules", "tolerance"])
def test_what_cannot_be_left_out(read, field):
    value = document()
    del value[field]
    assert faults(read, value) == [f"{field}: required, but missing"]


@pytest.mark.parametrize("lengths", [[0.25, 0.2], [0.2, 0.2]])
def test_contracted_is_shorter_than_extended(read, lengths):
    expected = f"is {lengths[0]:g} contracted, so not {lengths[1]:g} extended"
    assert faults(read, changed("modules.0.lengths", lengths)) == [
        f"modules[1].lengths: {name} {expected}" for name in LABELS
    ]


@pytest.mark.parametrize(
    ("where", "value", "expected"),
    [
        ("actuators.0.module", 3, "actuators[1].module: 3, but the arm has modules 1 to 2"),
        ("actuators.0.actuator", "top", "actuators[1].actuator: 'top', but module 1 has left, diagonal, right"),
        ("actuators.0.actuator", "right", "actuators[3]: actuator 1.right is mapped already"),
    ],
)
def test_an_actuator_mapped_wrongly_is_missing_where_it_belongs(read, where, value, expected):
    assert faults(read, changed(where, value)) == [expected, "actuators: 1.left is not mapped"]


def test_an_actuator_left_out(read):
    value = document()
    del value["actuators"][4]
    assert faults(read, value) == ["actuators: 2.diagonal is not mapped"]


def test_buses_without_actuators_leave_all_unmapped(read):
    assert faults(read, changed("actuators", [])) == [
        f"actuators: {m}.{name} is not mapped" for m in (1, 2) for name in LABELS
    ]


def test_actuators_without_buses(read):
    example = "buses: [{name: can0, interface: socketcan, channel: can0, bitrate: 500000}]"
    words = f"'can0', but the file lists no buses; needed is, for example, {example}"
    expected = [f"actuators[{k + 1}].bus: {words}" for k in range(6)]
    assert faults(read, changed("buses", [])) == expected


def test_faults_of_every_section_come_together(read):
    value = document()
    value["boards"]["heartbeat_timeout"] = 0.1
    value["modules"] += [{**TRUSS, "width": 2}, {**TRUSS, "lengths": [0.25, 0.2]}, *listed({"position": [0, 1]})]
    value["modules"][3]["states"].append({"position": [0, 1, 1], "orientation": 1.0})
    value["base"] = {"position": [0, 0], "orientation": [1, 1, 0, 0]}
    paths = [fault.split(":")[0] for fault in faults(read, value)]
    assert paths == [
        "boards.heartbeat_timeout",
        "modules[2].lengths",
        *["modules[3].lengths"] * 3,
        "modules[4].states[2].orientation",
        "base.orientation",
    ]


def test_faults_of_the_wiring_come_together(read):
    value = document()
    value["buses"][1]["name"] = "can0"
    value["actuators"][1]["output"] = 0
    value["actuators"][2]["bus"] = "can7"
    value["actuators"][5]["actuator"] = "up"
    paths = [fault.split(":")[0] for fault in faults(read, value)]
    assert paths == ["buses[2].name", "actuators[6].actuator", "actuators[3].bus", "actuators[2].output", "actuators"]


def test_a_file_that_is_missing_or_says_nothing(tmp_path):
    with pytest.raises(InputFaults, match="no such file"):
        load(tmp_path / "arm.yaml")
    (tmp_path / "arm.yaml").touch()
    with pytest.raises(InputFaults, match="is empty, as a failure of the power can leave it"):
        load(tmp_path / "arm.yaml")


scalars = (
    st.none()
    | st.booleans()
    | st.integers(-3, 300)
    | st.integers(-(10**30), 10**30)
    | st.floats()
    | st.sampled_from(["", "x", "vgt", "transforms", "can0", "left", "AD", "hold", "a\n", "🦾", "1", "2020-01-01"])
)
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=5) | st.dictionaries(st.sampled_from(["type", "x", "states"]), inner, max_size=3)
    ),
    max_leaves=6,
)


def places(value, path=()):
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in inner:
        yield (*path, key)
        yield from places(part, (*path, key))


SPATIAL = {
    "name": "spatial",
    "modules": [*listed({"position": [0, 0, 1], "orientation": [0, 0, 0, 1]}, {"position": [0, 1, 1]}, count=2), TRUSS],
    "tolerance": {"position": 0.01},
    "obstacles": [
        {"sphere": {"centre": [2, 2, 0], "radius": 0.3}},
        {"box": {"centre": [-1, 1, 9], "size": [0.4, 0.2, 1], "orientation": [0, 0.6, 0, 0.8]}, "name": "shelf"},
        {"half_space": {"point": [0, 0, -0.2], "normal": [0, 0, 1]}},
    ],
}
CORNERS = [[0.1, 0.0], [-0.05, 0.087], [-0.05, -0.087]]
MIXED = {
    "name": "mixed",
    "modules": [
        {"type": "revolute", "axis": [1, 0, 0], "angles": [-0.3, 0, 0.3], "link": {"position": [0, 0, 0.1]}},
        {"type": "prismatic", "axis": [0, 1], "lengths": [0.1, 0.2], "count": 2},
        {
            "type": "platform",
            "base": [[*p, 0.0] for p in CORNERS],
            "top": [[*p, 0] for p in CORNERS],
            "lengths": [0.2, 0.22],
        },
        {"type": "platform", "base": CORNERS[::-1], "top": [[-0.1, 0], [-0.1, 0.02], [0.1, 0]], "lengths": [0.2, 0.22]},
        {"type": "transforms", "table": "none.csv"},
    ],
    "tolerance": {"position": 0.01},
}
SEEDS = [document(), SPATIAL, MIXED]


@settings(max_examples=60)
@given(data=st.data(), seed=st.sampled_from(SEEDS), mutations=st.integers(1, 3))
def test_however_a_document_is_changed_it_loads_or_says_why_not(read, data, seed, mutations):
    value = copy.deepcopy(seed)
    for _ in range(mutations):
        *path, last = data.draw(st.sampled_from(list(places(value))))
        part = value
        for key in path:
            part = part[key]
        if data.draw(st.booleans()):
            part[last] = data.draw(values)
        else:
            del part[last]
        if not value:
            break
    try:
        arm = read(value)
    except InputFaults as error:
        said = error.faults
    else:
        said = arm.manipulator.actuators
    assert said
    assert all(said)


@pytest.mark.parametrize(
    ("obstacle", "expected"),
    [
        (
            {"disc": {"centre": [2, 2], "radius": 1}},
            ": one of sphere, box, half_space is needed for a spatial arm, got disc",
        ),
        (
            {"box": {"centre": [2, 2], "size": [1, 1, 1], "angle": 0.1}},
            ".box.centre: 2 coordinates, a spatial arm's have 3",
        ),
        (
            {"box": {"centre": [9, 2, 2], "size": [1, 1, 1], "angle": 0.1}},
            ".box.angle: a box in space is turned by an `orientation`, a quaternion x, y, z, w",
        ),
        (
            {"box": {"centre": [9, 2, 2], "size": [1, 1, 1], "orientation": [0, 0, 1, 1]}},
            ".box.orientation: a quaternion x, y, z, w of length 1 is needed, got [0.0, 0.0, 1.0, 1.0]",
        ),
        ({"half_space": {"point": [0, 0, 0], "normal": [0, 0]}}, ".half_space.normal: 2 coordinates, a spatial arm's"),
    ],
)
def test_regions_of_a_spatial_arm_that_are_wrong(read, obstacle, expected):
    fault, *_ = faults(read, {**SPATIAL, "obstacles": [obstacle]})
    assert fault.startswith(f"obstacles[1]{expected}")


def test_stuck_actuators_that_leave_a_module_no_state_are_named(read):
    value = document()
    value["modules"] = [{"type": "revolute", "angles": [0.0, 0.1, 0.2]}]  # spelled 00, 01, 11
    value["actuators"] = [
        {"module": 1, "actuator": "1", "bus": "can0", "node": 1, "output": 0, "stuck": "extended"},
        {"module": 1, "actuator": "2", "bus": "can0", "node": 1, "output": 1, "stuck": "contracted"},
    ]
    expected = "as they are stuck, module 1 has no state in which 1 is extended and 2 is contracted"
    assert faults(read, value) == [f"actuators: {expected}"]
