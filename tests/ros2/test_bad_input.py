"""What once did harm: answers, results, states and descriptions of another form, ids of others, floods."""

import pytest
import zenoh

from hyperbit.controller.ros2.arm_node import MOST_LETTERS
from hyperbit.controller.ros2.wire.actions import Status
from hyperbit.controller.ros2.wire.cdr import serialize
from tests import told
from tests.ros2.rig import ID, Rig, trajectory_goal
from tests.ros2.world.inputs import ACTUATORS, ATTACHMENT, TYPES
from tests.ros2.world.network import Sample
from tests.ros2.world.world import entries

END = {"id": ID, "status": "succeeded", "code": 0, "message": "reached"}


@pytest.mark.parametrize("field", ["frames", "drawing", "base", "name", "actuators", "dimension"])
def test_a_description_of_another_form_leaves_the_node(rig: Rig, field: str) -> None:
    before = set(rig.network.tokens)
    rig.hear("arm", told.described(**{field: None}))
    assert rig.network.tokens == before
    rig.hear("arm", told.described(name="other", version="2"))
    assert {it.split("/")[7] for it in rig.network.tokens} == {"%other"}


def test_a_sentence_quotes_little(rig: Rig) -> None:
    assert not rig.send_goal(goal=trajectory_goal(["x" * 500_000], [[1.0]]))
    assert 100 < len(rig.network.said[-1]) < 2 * MOST_LETTERS


def test_goals_of_topics_whose_results_are_lost_are_forgotten(rig: Rig) -> None:
    sizes = []
    for _ in range(3):
        for _ in range(100):
            rig.clock.sleep(1.0)
            rig.send_pose()
            rig.threads.run()
        sizes.append(entries(rig.bridge))
    assert sizes[1] == sizes[2]


def test_an_id_of_the_other_action_is_rejected_and_harms_no_goal(rig: Rig) -> None:
    rig.hear("state", told.state())
    assert rig.send_goal()
    for _ in range(2):  # while it runs, and after its end
        assert not rig.send_goal(ACTUATORS, trajectory_goal(["1.left"], [[1.0]]))
        rig.hear("result", END)
    assert rig.result()[0] is Status.SUCCEEDED
    rig.restart()
    assert rig.result()[0] is Status.SUCCEEDED


def test_set_points_that_the_daemon_refuses_are_told(rig: Rig) -> None:
    rig.hear("state", told.state())
    for refused in (3, 3, 5):
        counts = {"refused": refused, "last_refusal": "it is 0.31 s old"}
        rig.hear("diagnostics", told.DIAGNOSTICS | {"setpoint": counts})
        rig.clock.sleep(10.0)
        rig.hear("state", told.state())
    sentences = [it for it in rig.network.said if "set-points" in it]
    assert sentences == ["2 set-points are refused, the last because it is 0.31 s old"]


def test_what_fits_no_goal_of_a_topic_is_told(rig: Rig) -> None:
    rig.call("setpoint", pose={"position": {"x": float("inf")}})
    assert "a set-point is refused: setpoint.pose.position.x: inf" in rig.network.said[-1]
    rig.call("goal_pose", header={"frame_id": "map"})
    assert "frame_id: 'map', expected 'world' or 'planar16/0'" in rig.network.said[-1]


def test_a_measured_tip_reaches_the_daemon_in_the_unit_of_its_file(rig: Rig) -> None:
    rig.hear("arm", told.described(unit="mm"))
    for number, stamp in ((0.4, {}), (float("nan"), {}), (0.5, {"sec": 1_500_000_000})):
        fields = {"header": {"stamp": stamp}, "pose": {"position": {"x": number, "y": 2.9}}}
        data = zenoh.ZBytes(serialize(fields, "geometry_msgs/msg/PoseStamped", TYPES))
        rig.network.handlers["measured_tip"](Sample(data, zenoh.ZBytes(ATTACHMENT)))
    assert [it["position"] for it in rig.measured] == [pytest.approx([400.0, 2900.0]), pytest.approx([500.0, 2900.0])]
    assert [it["stamp"] for it in rig.measured] == [pytest.approx(rig.clock.time()), 1.5e9]
    assert "a measured tip is not sent: measured_tip.pose.position.x: nan" in rig.network.said[-1]


def test_an_arm_without_a_unit_counts_as_metres_and_says_so(rig: Rig) -> None:
    assert not any("names no unit" in it for it in rig.network.said)
    rig.hear("arm", told.described(unit=None))
    assert sum("the arm's file names no unit: its lengths count as metres" in it for it in rig.network.said) == 1
