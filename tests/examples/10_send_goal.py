"""Plan a path here, send it to a daemon over Zenoh, and wait for the result.

Start a daemon first: hyperbit run deploy/planar16.yaml --simulate
Then: python 10_send_goal.py [ENDPOINT]
"""

import json
import queue
import sys
from pathlib import Path
from typing import Any

import zenoh

import hyperbit as hb

PLANAR16 = Path(__file__).parents[2] / "deploy" / "planar16.yaml"
ENDPOINT = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
PATIENCE = 60.0  # [s]


def request(session: zenoh.Session, key: str, message: dict[str, Any]) -> dict[str, Any]:
    """Returns the daemon's answer to a request."""
    for reply in session.get(key, payload=json.dumps(message), timeout=PATIENCE):
        if reply.ok is not None:
            return dict(json.loads(reply.ok.payload.to_bytes()))
    raise SystemExit(f"no daemon answers on {key} at {ENDPOINT}")


arm = hb.load(PLANAR16)
goals = [hb.Goal((0.55, 2.9)), hb.Goal((0.4, 2.9))]
path = hb.Solver(arm).follow(goals)
print(f"planned: {path.switches} switches")

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([ENDPOINT]))
with zenoh.open(config) as session:
    results: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    keys = f"hyperbit/{arm.name}"
    subscriber = session.declare_subscriber(
        f"{keys}/result", lambda sample: results.put(json.loads(sample.payload.to_bytes()))
    )
    # The configurations planned here; a waypoint with a `position` lets the daemon search.
    texts = [arm.format(configuration) for configuration in path.configurations]
    waypoints = [{"t": float(k), "configuration": text} for k, text in enumerate(texts)]
    answer = request(session, f"{keys}/goal", {"id": "example", "waypoints": waypoints})
    print(f"accepted: {answer['accepted']}: {answer['message']}")
    if answer["accepted"]:
        while (result := results.get(timeout=PATIENCE))["id"] != "example":
            pass
        position = [round(x, 4) for x in result["position"]]
        print(f"{result['status']} at {position} after {result['switches']} switches")
