"""Recorders killed in full run: each loses at most a second, and its file is read and repaired."""

import json
import os
import random
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.recorder.folder import Folder
from hyperbit.controller.recorder.recording import FLUSH_EVERY
from tests.endpoints import free_endpoint
from tests.recorder.samples import read, read_by_another, read_unfinished, recovered_by_another
from tests.told import arm as planar
from tests.told import described, state
from tests.waiting import eventually

ROUNDS, TOGETHER = 2, 5  # 10 kills
LATEST = 2.5  # [s] after the first message, that a kill comes

# `hyperbit record` which notes the log time of each message that it takes, before it writes the message.
NOTING = """
import os, struct, sys
from hyperbit.controller.recorder.recording import Recording
from hyperbit.controller.cli import main
notes, write = os.open(sys.argv.pop(1), os.O_WRONLY | os.O_CREAT | os.O_APPEND), Recording.write
def noting(self, topic, kind, data, log_time, publish_time):
    os.write(notes, struct.pack("<q", log_time))
    write(self, topic, kind, data, log_time, publish_time)
Recording.write = noting
main()
"""


@pytest.fixture
def daemon() -> Iterator[str]:
    """The endpoint of a daemon that publishes an arm's state 50 times a second, as fast as the machine lets it."""
    arm, ending, endpoint = planar(), threading.Event(), free_endpoint()
    description = json.dumps(described(arm)).encode()

    def publish(opened: zenoh.Session) -> None:
        k = 0
        while not ending.wait(0.02):
            k += 1
            message = state(arm, [k // 10 % 8] * 16, stamp=time.time())
            opened.put("hyperbit/planar16/state", json.dumps({**message, "waypoint": k}))

    with zenoh.open(session.configuration("peer", listen=endpoint)) as opened:
        _declared = [
            opened.liveliness().declare_token("hyperbit/planar16/alive"),
            opened.declare_queryable(
                "hyperbit/planar16/arm", lambda it: it.reply("hyperbit/planar16/arm", description)
            ),
        ]
        thread = threading.Thread(target=publish, args=(opened,))
        thread.start()
        yield endpoint
        ending.set()
        thread.join()


def noted(path: Path) -> list[int]:
    """The log times of the messages that a recorder took."""
    data = path.read_bytes() if path.exists() else b""
    return [time for (time,) in struct.iter_unpack("<q", data[: len(data) // 8 * 8])]


@pytest.mark.timeout(600)
@pytest.mark.real_time
def test_a_killed_recorder_loses_at_most_a_second(daemon: str, tmp_path: Path) -> None:
    losses, draw = [], random.Random(5)
    for k in range(ROUNDS):
        with ExitStack() as stack:
            folders = [tmp_path / f"{k}-{j}" for j in range(TOGETHER)]
            recorders = [start(stack, daemon, folder) for folder in folders]
            for folder in folders:
                eventually(lambda folder=folder: noted(folder.with_suffix(".notes")))
            for folder, recorder in zip(folders, recorders, strict=True):
                time.sleep(draw.uniform(0.0, LATEST / TOGETHER * 2))
                recorder.send_signal(signal.SIGKILL)
                assert recorder.wait() == -signal.SIGKILL
                losses.append(lost(folder))
    assert len(losses) == ROUNDS * TOGETHER
    assert max(losses) < FLUSH_EVERY


def start(stack: ExitStack, endpoint: str, folder: Path) -> subprocess.Popen[bytes]:
    notes = str(folder.with_suffix(".notes"))
    command = [sys.executable, "-c", NOTING, notes, "record", "planar16", "--folder", str(folder)]
    recorder = subprocess.Popen([*command, "--connect", endpoint], stderr=subprocess.DEVNULL, cwd=os.getcwd())
    stack.callback(recorder.wait)
    stack.callback(recorder.kill)
    return recorder


def lost(folder: Path) -> int:
    """How long the messages last that a killed recorder took and lost [ns]; its file is read, repaired, read again."""
    taken = noted(folder.with_suffix(".notes"))
    (path,) = folder.glob("*.mcap")
    data = path.read_bytes()
    found = read_unfinished(data)
    assert found == recovered_by_another(data)
    times = [message.at for message in found]
    assert times == taken[: len(times)], "what is in the file are the messages taken first"
    Folder(folder, "planar16").close()
    if found:
        assert sorted(read(path), key=repr) == sorted(found, key=repr) == sorted(read_by_another(path), key=repr)
        assert any(message.topic.endswith("/arm") for message in found) or len(found) < 100
    missing = taken[len(times) :]
    # The last message is noted before it has what is older than a second flushed: the kill may come in between.
    return missing[-2] - missing[0] if len(missing) > 1 else 0
