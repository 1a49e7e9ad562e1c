"""What a stranger sends on an arm's keys is recorded, and takes nothing from the arm's own messages."""

import json
from contextlib import ExitStack
from pathlib import Path

import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.listener import Listener
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.recorder import Limits, Recorder
from hyperbit.controller.recorder.schemas import FOXGLOVE, LOG, SCENE, TRANSFORMS
from tests.recorder.samples import heard, read
from tests.recorder.shapes import misfits
from tests.strangers import intrude
from tests.told import arm as planar
from tests.told import described, state
from tests.waiting import eventually


def test_the_arm_is_recorded_beside_a_stranger(tmp_path: Path) -> None:
    arm, endpoint = planar(), f"unixsock-stream/{tmp_path}/z.sock"
    recorder, keys = Recorder("planar16", Folder(tmp_path, "planar16"), Limits(10**9, 10**9)), set[str]()
    with ExitStack() as closing:
        stranger = closing.enter_context(zenoh.open(session.configuration("peer", listen=endpoint)))
        own = closing.enter_context(zenoh.open(session.configuration("client", connect=endpoint)))
        listener = Listener(own, "planar16")
        closing.callback(listener.close)

        def recorded() -> bool:
            stranger.put("hyperbit/planar16/last", b"{}")
            for item in listener.receive_messages(0.1):
                recorder.receive_message(item)
                keys.add(item.key)
            return "last" in keys

        intrude(stranger, "hyperbit/planar16")
        eventually(recorded)
    recorder.receive_message(heard(1e9, "arm", described(arm)))
    recorder.receive_message(heard(1e9, "state", state(arm, [0] * 16, stamp=7.0)))
    recorder.end_recording()
    (path,) = tmp_path.glob("*.mcap")
    topics: dict[str, list[object]] = {}
    for message in read(path):
        topics.setdefault(message.topic.rpartition("/")[2], []).append(message.data)
    assert json.loads(json.dumps(topics["state"][-1]))["stamp"] == 7.0
    for topic, kind in (("scene", SCENE), ("frames", TRANSFORMS), ("log", LOG)):
        assert topics[topic]
        assert [misfits(it, FOXGLOVE[kind]) for it in topics[topic]] == [[]] * len(topics[topic])
