"""What Foxglove draws is where forward kinematics has the arm."""

from typing import Any

import numpy as np
import pytest
from msgspec import convert

from hyperbit.controller.arm.arm import load
from hyperbit.controller.manipulator import frames
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.parts import Pose
from hyperbit.controller.pictures.scene import (
    MEASURED,
    TRAVELLING,
    UNKNOWN,
    FoxgloveScene,
    quaternion,
    rgba,
    shown_of,
    turn_to,
)
from hyperbit.controller.recorder.schemas import FOXGLOVE, SCENE, TRANSFORMS
from tests.keys import DEPLOY
from tests.recorder.shapes import misfits
from tests.told import arm as planar
from tests.told import described, read_arm, read_state

ARMS = ("planar16", "revolute24", "platform8", "motor12")


def matrix(translation: dict[str, float], rotation: dict[str, float]) -> np.ndarray:
    return frames.spatial([translation[k] for k in "xyz"], [rotation[k] for k in "xyzw"])


@pytest.mark.parametrize("name", ARMS)
def test_frames_and_lines_are_the_arms(name: str) -> None:
    arm = load(DEPLOY / f"{name}.yaml")
    m, scene = arm.manipulator, FoxgloveScene(read_arm(arm))
    rng = np.random.default_rng(3)
    for _ in range(3):
        configuration = [int(rng.integers(count)) for count in m.states]
        now = shown_of(read_state(arm, configuration, stamp=5.25))
        message = scene.transforms(now, 5.25)
        assert misfits(message, FOXGLOVE[TRANSFORMS]) == []
        chain, found, parent = m.chain(configuration), np.eye(4), "world"
        for k, told_frame in enumerate(message["transforms"]):
            assert (told_frame["parent_frame_id"], told_frame["child_frame_id"]) == (parent, f"{name}/{k}")
            parent = told_frame["child_frame_id"]
            found = found @ matrix(told_frame["translation"], told_frame["rotation"])
            np.testing.assert_allclose(found, chain[k], atol=1e-6)
            assert told_frame["timestamp"] == {"sec": 5, "nsec": 250_000_000}
        update = scene.update(now, 5.25)
        assert misfits(update, FOXGLOVE[SCENE]) == []
        points = []
        for k, entity in enumerate(update["entities"][: len(m.modules)]):
            assert entity["frame_id"] == f"{name}/{k}"
            local = np.array([[p[axis] for axis in "xyz"] for p in entity["lines"][0]["points"]])
            points.append(local @ chain[k][:3, :3].T + chain[k][:3, 3])
        np.testing.assert_allclose(np.concatenate(points), m.body(configuration).reshape(-1, 3), atol=1e-6)


def test_colours_tell_what_is_measured() -> None:
    arm = planar()
    scene, now = FoxgloveScene(read_arm(arm)), shown_of(read_state(arm, [0] * 16, stamp=1.0))

    def colours(**changes: Any) -> list[Any]:
        entities = scene.update(now._replace(**changes), 1.0)["entities"][:16]
        return [entity["lines"][0]["color"] for entity in entities]

    assert colours() == [rgba(MEASURED)] * 16
    unknown, travelling = list(now.measured or ()), list(now.measured or ())
    unknown[0], travelling[3] = None, 1
    assert colours(measured=unknown) == [rgba(UNKNOWN)] + [rgba(MEASURED)] * 15
    assert colours(measured=travelling) == [rgba(MEASURED), rgba(TRAVELLING)] + [rgba(MEASURED)] * 14
    assert colours(measured=[None] * 48, commanded=None) == [rgba(UNKNOWN)] * 16


def test_goal_and_obstacles_are_drawn() -> None:
    obstacles = [
        {"disc": {"centre": [1.2, 2.0], "radius": 0.3}, "name": "pillar"},
        {"box": {"centre": [1.0, 1.0], "size": [0.5, 0.25], "angle": np.pi}},
    ]
    sent = [{"half_plane": {"point": [0.0, -0.1], "normal": [0.0, 1.0]}}, {"none": {}}]
    now = shown_of(read_state(planar(), [0] * 16, stamp=1.0, target={"position": [0.5, 2.9], "orientation": None}))
    update = FoxgloveScene(read_arm(planar(), obstacles=obstacles, sent_obstacles=sent)).update(now, 1.0)
    assert misfits(update, FOXGLOVE[SCENE]) == []
    goal, regions = update["entities"][-2:]
    assert goal["spheres"][0]["pose"]["position"] == {"x": 0.5, "y": 2.9, "z": 0.0}
    assert regions["cylinders"][0]["size"]["x"] == 0.6
    box, floor = regions["cubes"]
    assert box["pose"]["orientation"]["z"] == pytest.approx(1.0)
    sides = np.array([floor["size"][axis] for axis in "xyz"])
    turned = matrix(floor["pose"]["position"], floor["pose"]["orientation"])
    top = turned @ np.array([sides[0] / 2, 0, 0, 1])
    np.testing.assert_allclose(top[:3], [0.0, -0.1, 0.0], atol=1e-6)


def test_spheres_and_half_spaces_are_drawn() -> None:
    arm = load(DEPLOY / "platform8.yaml")
    obstacles = [
        {"sphere": {"centre": [1.0, 2.0, 3.0], "radius": 0.5}},
        {"half_space": {"point": [0.0, 0.0, -1.0], "normal": [0.0, 0.0, 2.0]}},
        {"box": {"centre": [1, 1, 1], "size": [1, 2, 3], "orientation": [0, 0, 0, 1]}},
    ]
    now = shown_of(read_state(arm, [0] * 8, stamp=1.0))
    update = FoxgloveScene(read_arm(arm, obstacles=obstacles)).update(now, 1.0)
    assert misfits(update, FOXGLOVE[SCENE]) == []
    regions = update["entities"][-1]
    assert regions["spheres"][0]["size"] == {"x": 1.0, "y": 1.0, "z": 1.0}
    assert [cube["size"]["z"] for cube in regions["cubes"]][1] == 3.0


def test_quaternions_are_those_of_the_manipulator() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        drawn = rng.normal(size=4)
        frame = frames.spatial((0, 0, 0), drawn / np.linalg.norm(drawn))
        found = quaternion(frame[:3, :3])
        np.testing.assert_allclose(matrix({"x": 0, "y": 0, "z": 0}, found), frame, atol=1e-7)
        normal = drawn[:3] / np.linalg.norm(drawn[:3])
        turned = frames.spatial((0, 0, 0), turn_to(normal))
        np.testing.assert_allclose(turned[:3, 0], normal, atol=1e-9)
    np.testing.assert_allclose(frames.spatial((0, 0, 0), turn_to(np.array([-1.0, 0, 0])))[:3, 0], [-1, 0, 0])


@pytest.mark.parametrize("broken", ["drawing", "frames", "actuators", "base"])
def test_an_arm_that_is_told_otherwise_is_refused(broken: str) -> None:
    arm = described(planar())
    with pytest.raises((LookupError, ValueError, TypeError)):
        FoxgloveScene(convert({key: value for key, value in arm.items() if key != broken}, Description))
    with pytest.raises((LookupError, ValueError, TypeError)):
        FoxgloveScene(convert({**arm, broken: []}, Description))


def test_a_scene_is_in_metres_whatever_unit_the_daemon_has() -> None:
    large = described(planar())
    obstacles = [
        {"disc": {"centre": [1.0, 2.0], "radius": 0.5}, "name": "pillar", "box": None},
        {"box": {"centre": [-1.0, 2.0], "size": [0.5, 0.25], "angle": 0.5}},
        {"half_plane": {"point": [0.0, -1.0], "normal": [0.0, 1.0]}},
    ]
    whole = {**large, "unit": "m", "sent_obstacles": obstacles}
    thousandth = {
        **whole,
        "unit": "mm",
        "length": 1e3 * whole["length"],
        "base": raised(whole["base"]),
        "frames": [raised(frames) for frames in whole["frames"]],
        "drawing": {
            **whole["drawing"],
            "kinds": [{**it, "body": (1e3 * np.array(it["body"])).tolist()} for it in whole["drawing"]["kinds"]],
        },
        "sent_obstacles": [
            {"disc": {"centre": [1e3, 2e3], "radius": 500.0}, "name": "pillar", "box": None},
            {"box": {"centre": [-1e3, 2e3], "size": [500.0, 250.0], "angle": 0.5}},
            {"half_plane": {"point": [0.0, -1e3], "normal": [0.0, 1.0]}},
        ],
    }
    now = shown_of(read_state(planar(), [0] * 16, stamp=1.0))
    target = Pose([0.5, 2.5]), Pose([500.0, 2500.0])
    scenes = [FoxgloveScene(convert(it, Description)) for it in (whole, thousandth)]
    updates = [scene.update(now._replace(target=at), 1.0) for scene, at in zip(scenes, target, strict=True)]
    assert numbers(updates[1]) == pytest.approx(numbers(updates[0]), abs=1e-8)
    frames_of = [scene.transforms(now, 1.0) for scene in scenes]
    assert numbers(frames_of[1]) == pytest.approx(numbers(frames_of[0]), abs=1e-8)
    with pytest.raises(ValueError, match="unit: 'ft' is none of m, cm, mm, in"):
        FoxgloveScene(convert({**whole, "unit": "ft"}, Description))


def raised(matrices: Any) -> Any:
    array = np.array(matrices)
    array[..., :3, 3] *= 1e3
    return array.tolist()


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict | list):
        return [it for part in (value.values() if isinstance(value, dict) else value) for it in numbers(part)]
    return [float(value)] if isinstance(value, int | float) else []
