"""The cost of the page: a stop from it against the command's own request, and the planner with 20 pages open.

python -m tests.benchmarks.page.panel [--stops 30] [--seconds 20] [--json PATH]

Stops interrupt a goal of 48 switches, one at a time (`inrush: 1`), so that SYNCs follow each other closely. A stop's
time begins with the request's first byte. It ends with the goal's last SYNC on the bus, and is 0 if none came after
the request. As the operator sees it, the time ends when a client of its own hears the state `stopped`. Boards,
executor, planner and panel are processes of their own; all read the same clock.
"""

import json
import os
import random
import re
import statistics
import subprocess
import sys
import threading
import time
from contextlib import ExitStack

import httpx2
import numpy as np
from numpy.typing import NDArray
from websockets.sync.client import ClientConnection, connect

from hyperbit.controller.panel.access.people import digest_of
from tests.benchmarks.daemon.chain.parts import Parts
from tests.benchmarks.harness import CommandLine, percentiles, processor_time, report
from tests.system.stack.observer import Observer
from tests.waiting import PATIENCE, eventually

PAGES, ARM = 20, "planar16"
BETWEEN = 0.05, 0.3  # [s] from the acceptance of a goal to its stop
ROW = "p50", "p75", "worst"
WITHIN = 20.0  # bar: [ms] between the medians


def page(closing: ExitStack, url: str, cookie: str) -> ClientConnection:
    socket = connect(
        f"{url.replace('http', 'ws')}arms/{ARM}/live", origin=url.rstrip("/"), additional_headers={"cookie": cookie}
    )  # type: ignore[arg-type]
    closing.callback(socket.close)

    def read() -> None:
        for _ in socket:
            pass

    threading.Thread(target=read, daemon=True).start()
    return socket


def serve(closing: ExitStack, parts: Parts) -> tuple[str, str]:
    people, log = parts.folder / "people.yaml", parts.folder / "panel.log"
    people.write_text(f"people: [{{name: a, role: operator, token: {digest_of('t')}}}]")
    words = ["panel", "--connect", parts.endpoint, "--listen", "127.0.0.1:0", "--people", str(people)]
    out = closing.enter_context(log.open("w"))
    environment = {**os.environ, "STATE_DIRECTORY": str(parts.folder)}
    panel = subprocess.Popen([sys.executable, "-m", "hyperbit", *words], stdout=out, stderr=out, env=environment)
    closing.callback(panel.wait, PATIENCE)
    closing.callback(panel.terminate)
    url = eventually(lambda: re.findall(r"http://\S+", log.read_text()))[0]
    answer = httpx2.post(f"{url}session", json={"token": "t"}, headers={"origin": url.rstrip("/")})
    return url, answer.headers["set-cookie"].partition(";")[0]


def stop_often(client: Observer, live: ClientConnection, count: int) -> dict[str, list[tuple[float, float]]]:
    """Stops goals, by the page and by the command in turn; returns when each stop was sent and heard [s]."""
    spans: dict[str, list[tuple[float, float]]] = {"page": [], "command": []}
    drawn = random.Random(16)
    client.reset()
    for k in range(2 * count):
        kind = ("page", "command")[k % 2]
        goal = {"waypoints": [{"configuration": ("7", "0")[(k + k // 2) % 2] * 16}]}
        eventually(lambda goal=goal, k=k: client.send("goal", id=f"{k} {time.monotonic()}", **goal)["accepted"])
        time.sleep(drawn.uniform(*BETWEEN))
        before, began, at = len(client.heard["state"]), time.monotonic(), time.time()
        if kind == "page":
            live.send(json.dumps({"do": "stop", "n": k}))
        else:
            client.ask("stop")
        client.wait_for("stopped", after=before)
        stopped = next(k for k, state in enumerate(client.heard["state"]) if k >= before and state["mode"] == "stopped")
        spans[kind].append((began, began + client.times["state"][stopped] - at))
        client.reset()
    return spans


def main() -> None:
    parser = CommandLine(__doc__)
    parser.add_argument("--stops", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=20.0)
    wanted = parser.parse()
    shares: dict[str, list[float]] = {}
    with Parts(real_time=True, travel_time=0.01, inrush=1) as parts, ExitStack() as closing:
        url, cookie = serve(closing, parts)
        client = parts.client()
        live = page(closing, url, cookie)
        time.sleep(1.0)
        spans = stop_often(client, live, wanted.stops)
        for count in (0, PAGES, 0, PAGES):
            with ExitStack() as pages:
                for _ in range(count):
                    page(pages, url, cookie)
                time.sleep(2.0)
                before = processor_time(parts.processes["planner"].pid)
                time.sleep(wanted.seconds)
                share = (processor_time(parts.processes["planner"].pid) - before) / wanted.seconds
            shares.setdefault(f"{count + 1} pages", []).append(round(100 * share, 2))
        real_time = client.diagnosed()["real_time"]
    syncs = parts.record("syncs")["at"]
    to_last = {kind: [last(syncs, *span) for span in own] for kind, own in spans.items()}
    heard = {kind: [b - a for a, b in own] for kind, own in spans.items()}
    medians = {kind: 1e3 * statistics.median(times) for kind, times in to_last.items()}
    difference = medians["page"] - medians["command"]
    figures = {
        "SYNCs of the goals apart [ms]": round(1e3 * float(np.median(np.diff(syncs))), 2),
        "to the last SYNC [ms]": {kind: percentiles(times, *ROW) for kind, times in to_last.items()},
        "no SYNC after the request": {kind: sum(time == 0.0 for time in times) for kind, times in to_last.items()},
        "until stopped is heard [ms]": {kind: percentiles(times, *ROW) for kind, times in heard.items()},
        "difference of the medians to the last SYNC [ms]": round(difference, 2),
        "stops of each kind": wanted.stops,
        "processor of the planner [%]": shares,
        "real_time": real_time,
    }
    report(figures, {f"medians within {WITHIN:g} ms": abs(difference) <= WITHIN}, wanted.json)


def last(syncs: NDArray[np.float64], began: float, heard: float) -> float:
    """Returns the time from a stop to the last SYNC before the state was heard [s]; 0 if none came after the stop."""
    k = int(np.searchsorted(syncs, heard)) - 1
    return max(float(syncs[k]) - began, 0.0) if k >= 0 else 0.0


if __name__ == "__main__":
    main()
