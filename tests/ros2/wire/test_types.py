"""Definitions and hashes of types; rosbags computes the hashes a second time, by REP 2016."""

from typing import Any

import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import TIDMAP

from hyperbit.controller.ros2.wire.types import DEFINITIONS, VERSIONS, Types, UnknownType

FOLLOW = "control_msgs/action/FollowJointTrajectory"
# Of the wheels of ROS 2 Humble to Kilted on PyPI; those of the action by ROS's own generator.
KNOWN = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "visualization_msgs/msg/MarkerArray": "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
    "diagnostic_msgs/msg/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "nav_msgs/msg/Path": "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b",
    "trajectory_msgs/msg/JointTrajectory": "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    "rcl_interfaces/msg/Log": "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "action_msgs/srv/CancelGoal": "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    "action_msgs/msg/GoalStatusArray": "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    f"{FOLLOW}_SendGoal": "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
    f"{FOLLOW}_GetResult": "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
    f"{FOLLOW}_FeedbackMessage.jazzy": "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    f"{FOLLOW}_FeedbackMessage.kilted": "95618cc73912d99b9acaa17d2da5e832cb0bfdeede7534fa8ec600feca2a6c4b",
}


def define_service(name: str, definitions: dict[str, Any]) -> None:
    """Adds the structure of a service, and that of the event which tells of its calls."""
    request, response, event = (f"{name}_{part}" for part in ("Request", "Response", "Event"))
    definitions[event] = (
        [],
        [
            ("info", (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")),
            ("request", (Nodetype.SEQUENCE, ((Nodetype.NAME, request), 1))),
            ("response", (Nodetype.SEQUENCE, ((Nodetype.NAME, response), 1))),
        ],
    )
    parts = {"request_message": request, "response_message": response, "event_message": event}
    definitions[name] = [], [(part, (Nodetype.NAME, type_name)) for part, type_name in parts.items()]


@pytest.mark.parametrize("distribution", VERSIONS)
def test_each_hash_is_that_of_its_definition(distribution: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TIDMAP, "char", TIDMAP["uint8"])  # as ROS has it
    types = Types(distribution)
    definitions: dict[str, Any] = types.store.fielddefs
    for name in types.hashes:
        if f"{name}_Request" in definitions:
            define_service(name, definitions)
    assert types.hashes == {name: types.store.hash_rihs01(name) for name in types.hashes}


@pytest.mark.parametrize("distribution", VERSIONS)
def test_hashes_are_those_of_ros_2(distribution: str) -> None:
    types = Types(distribution)
    for key, value in KNOWN.items():
        name, _, version = key.partition(".")
        if version in ("", VERSIONS[distribution]):
            assert types.hash(name) == f"RIHS01_{value}"


@pytest.mark.parametrize("store", [Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL])
def test_messages_are_the_same_in_all_distributions(store: Stores) -> None:
    """So that the definitions of one do for all."""
    types, other = Types("jazzy"), get_typestore(store).fielddefs
    built_in = [name for name in types.store.fielddefs if name in other and name in types.hashes]
    assert len(built_in) > 70
    assert {name: types.store.fielddefs[name][1] for name in built_in} == {name: other[name][1] for name in built_in}


def test_the_feedback_of_follow_joint_trajectory_has_indices_since_kilted() -> None:
    fields = {it: {name for name, _ in Types(it).store.fielddefs[f"{FOLLOW}_Feedback"][1]} for it in VERSIONS}
    assert fields["kilted"] == fields["lyrical"] == fields["jazzy"] | {"index", "multi_dof_index"}
    assert "index" not in fields["jazzy"]


@pytest.mark.parametrize(
    ("distribution", "why"), [("humble", "no type hashes"), ("rolling", "jazzy, kilted, lyrical"), ("", "no known")]
)
def test_other_distributions_are_refused(distribution: str, why: str) -> None:
    with pytest.raises(UnknownType, match=why):
        Types(distribution)


def test_unknown_types_are_refused() -> None:
    types = Types("jazzy")
    with pytest.raises(UnknownType, match="sensor_msgs/msg/Nothing"):
        types.hash("sensor_msgs/msg/Nothing")
    with pytest.raises(UnknownType, match="std_srvs/srv/Trigger"):
        types.message_class("std_srvs/srv/Trigger")  # which is no message


def test_a_type_can_be_added() -> None:
    types = Types("jazzy")
    hashes = {f"demo/action/Count_{part}": "RIHS01_0" for part in ("SendGoal", "GetResult", "FeedbackMessage")}
    types.register("demo/action/Count", "int32 to  # comment\n---\n---\nint32 at\n", hashes)
    assert types.hash("demo/action/Count_GetResult") == "RIHS01_0"
    assert types.message_class("demo/action/Count_Goal")(to=3).to == 3


@pytest.mark.parametrize("text", ["int32 to\n", "---\n---\n---\n", "int32\n---\n---\n", "demo/msg/No x\n---\n---\n"])
def test_definitions_that_cannot_be_read_are_refused(text: str) -> None:
    with pytest.raises(UnknownType, match="demo/action/Count"):
        Types("jazzy").register("demo/action/Count", text, {})


def test_definitions_name_types_in_full() -> None:
    """A short name would be looked for in the folder of the service or action."""
    for path in DEFINITIONS.glob("*/*/*.*"):
        for line in path.read_text().splitlines():
            word = line.split()[0]
            assert word.count("/") in (0, 2), f"{path.name}: {line}"
            assert word == "---" or word.count("/") == 2 or word.rstrip("[]") in TIDMAP, f"{path.name}: {line}"
