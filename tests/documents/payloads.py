"""Names of the fields that a daemon sends, from a daemon with simulated boards and a tracker."""

from __future__ import annotations

import functools
import os
import queue
import tempfile
from pathlib import Path
from typing import Any
from unittest import mock

import yaml

from hyperbit.controller.commands.connection import connected
from tests.documents.page import ROOT
from tests.system.stack import daemon

WAIT = 60.0  # [s] for one message
WAYPOINT = {"position": [0.55, 2.9]}


@functools.cache
def payloads() -> dict[str, set[str]]:
    """Returns the names of the fields of answer, state, feedback, result, diagnostics and arm."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "planar16.yaml"
        settings = yaml.safe_load((ROOT / "deploy" / "planar16.yaml").read_text())
        file.write_text(yaml.safe_dump({**settings, "tracker": {"noise": 0.001, "clamp": 0.01}}))
        with (
            mock.patch.dict(os.environ, XDG_STATE_HOME=folder),
            daemon.running(file, Path(folder)) as endpoint,
            connected("planar16", endpoint, None) as client,
        ):
            news: dict[str, queue.SimpleQueue[dict[str, Any]]] = {}
            subscribers = []
            for key in ("state", "diagnostics"):
                news[key] = queue.SimpleQueue()
                subscribers.append(client.subscribe(key, news[key].put))
            told: list[dict[str, Any]] = []
            result: dict[str, Any] = {}
            while not feedback(told) or "travels" not in result:  # a machine that stands still aborts goals
                goal = client.run({"waypoints": [WAYPOINT]}, told.append, silence=WAIT)
                result = goal | client.run({"actuators": {"5.left": "extended"}}, silence=WAIT, key="jog")
            described = client.request("arm", {"with": ["drawing", "file", "density", "running"]}, timeout=WAIT)
            return {
                "answer": set(told[0]),
                "feedback": feedback(told),
                "result": set(result),
                "arm": set(described),
                **{key: set(messages.get(timeout=WAIT)) for key, messages in news.items()},
            }


def feedback(messages: list[dict[str, Any]]) -> set[str]:
    return {name for message in messages if "waypoint" in message for name in message}
