"""Named poses: saved, listed, removed, and kept over a restart; and their requests over Zenoh."""

from __future__ import annotations

import json
import queue
import uuid
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import cast

import pytest

from hyperbit.controller.gateway import poses as poses_module
from hyperbit.controller.gateway.poses import Poses, PosesMessage, decode_poses
from hyperbit.controller.messages.arm import NamedPose
from hyperbit.controller.messages.state import State
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal
from tests.gateway.conftest import Gateway
from tests.waiting import eventually

PICK = {"waypoints": [{"position": [0.5, 2.8]}]}
PLACE = {"waypoints": [{"configuration": "12"}]}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "a.poses.json"


def names(poses: Poses) -> list[object]:
    return [pose.name for pose in poses.listed()]


def test_poses_survive_a_restart_and_home_is_always_there(file: Path) -> None:
    poses = Poses(file, "00")
    assert poses.listed() == [NamedPose("home", {"waypoints": [{"configuration": "00"}]})]
    assert poses.change(PosesMessage(save="pick", goal=PICK)).message == "saved pose 'pick'"
    poses.change(PosesMessage(save="home", goal=PLACE))
    again = Poses(file, "00")
    assert again.listed() == [NamedPose("home", PLACE), NamedPose("pick", PICK)]
    again.change(PosesMessage(remove="home"))
    again.change(PosesMessage(remove="pick"))
    assert Poses(file, "00").listed() == [NamedPose("home", {"waypoints": [{"configuration": "00"}]})]
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_what_is_not_saved_cannot_be_removed(file: Path) -> None:
    poses = Poses(file, "00")
    poses.change(PosesMessage(save="pick", goal=PICK))
    with pytest.raises(Refusal, match="there is no saved pose 'pack'; saved are pick") as refused:
        poses.change(PosesMessage(remove="pack"))
    assert refused.value.reason is Reason.UNKNOWN_POSE


def test_an_arm_has_only_so_many_poses(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poses_module, "MOST_POSES", 2)
    poses = Poses(file, "00")
    for name in ("a", "b"):
        poses.change(PosesMessage(save=name, goal=PICK))
    poses.change(PosesMessage(save="b", goal=PLACE))
    with pytest.raises(Refusal, match="at most 2 saved poses"):
        poses.change(PosesMessage(save="c", goal=PICK))
    assert names(poses) == ["home", "a", "b"]


def test_all_poses_together_have_a_bounded_size(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poses_module, "MOST_STORED", 200)
    poses = Poses(file, "00")
    poses.change(PosesMessage(save="a", goal=PICK))
    with pytest.raises(Refusal, match="the saved poses") as refused:
        poses.change(PosesMessage(save="b", goal={"waypoints": [{"position": [0.5, 2.8]}] * 20}))
    assert refused.value.reason is Reason.TOO_LARGE
    assert names(poses) == ["home", "a"]


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"a": 5}', b'{"": {}}', b"\xff"])
def test_a_damaged_file_is_set_aside(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    poses = Poses(file, "00")
    assert names(poses) == ["home"]
    poses.change(PosesMessage(save="pick", goal=PICK))
    assert names(Poses(file, "00")) == ["home", "pick"]
    [aside] = file.parent.glob(f"{file.name}.damaged-*")
    assert aside.read_bytes() == content


def test_a_folder_that_cannot_be_written_refuses_and_changes_nothing(tmp_path: Path) -> None:
    poses = Poses(tmp_path / "gone" / "a.poses.json", "00")
    (tmp_path / "gone").touch()
    with pytest.raises(Refusal, match="exists"):
        poses.change(PosesMessage(save="pick", goal=PICK))
    assert names(poses) == ["home"]


@pytest.mark.parametrize(
    ("payload", "sentence"),
    [
        ({}, "either save and goal, or remove, are needed"),
        ({"save": "a"}, "either save and goal, or remove, are needed"),
        ({"goal": PICK}, "either save and goal, or remove, are needed"),
        ({"save": "a", "goal": PICK, "remove": "b"}, "either save and goal, or remove, are needed"),
        ({"goal": PICK, "remove": "b"}, "either save and goal, or remove, are needed"),
        ({"save": "a", "goal": {**PICK, "id": "x"}}, "goal.id: a saved goal has none"),
        ({"save": "a\n", "goal": PICK}, "save"),
        ({"save": " a", "goal": PICK}, "save"),
        ({"save": "a" * 41, "goal": PICK}, "save"),
        ({"save": "a", "goal": PICK, "more": 1}, "more"),
    ],
)
def test_malformed_requests_are_refused_by_field(payload: object, sentence: str) -> None:
    with pytest.raises(Refusal, match=sentence):
        decode_poses(json.dumps(payload).encode())


def test_poses_over_zenoh(endpoint: str) -> None:
    with ExitStack() as stack:
        gateway = Gateway(stack, endpoint)
        client = gateway.client()
        answer = client.request("poses", {"save": "pick", "goal": PICK})
        assert (answer["accepted"], answer["message"]) == (True, "saved pose 'pick'")
        assert [pose["name"] for pose in client.request("arm")["poses"]] == ["home", "pick"]
        wrong = client.request("poses", {"save": "far", "goal": {}})
        assert (wrong["accepted"], "waypoints" in wrong["message"]) == (False, True)
        odd = client.request("poses", {"save": "odd", "goal": {**PICK, "deadline": 10**400}})
        assert (odd["accepted"], odd["reason"] != "internal-error") == (False, True)
        missing = client.request("poses", {"remove": "far"})
        assert (missing["accepted"], missing["reason"]) == (False, "unknown-pose")
        assert client.request("poses", {"remove": "pick"})["accepted"]
        assert gateway.planner.keys() == [], "the planner hears of no pose"


def test_each_state_has_a_number_that_grows_when_the_poses_change(endpoint: str) -> None:
    with ExitStack() as stack:
        gateway = Gateway(stack, endpoint)
        client, states = gateway.client(), queue.SimpleQueue[dict[str, object]]()
        stack.enter_context(client.subscribe("state", states.put))

        def published() -> int:
            """Publishes states until one arrives that was queued after the call."""
            mark = str(uuid.uuid4())

            def came() -> dict[str, object] | None:
                gateway.outbox.publish("state", State(mode=mark))
                with suppress(queue.Empty):
                    return state if (state := states.get(timeout=0.1))["mode"] == mark else None
                return None

            return cast(int, eventually(came)["poses"])  # type: ignore[index]

        numbers = [published()]
        for payload in ({"save": "pick", "goal": PICK}, {"remove": "far"}, {"remove": "pick"}):
            client.request("poses", payload)
            numbers.append(published())
        assert numbers == [0, 1, 1, 2], "a refused change does not count"
