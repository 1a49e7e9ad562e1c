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
from tests.benchmarks.daemon.chain import Chain
from tests.benchmarks.harness import CommandLine, percentiles, processor_time, report
from tests.system.stack.observer import Observer
from tests.waiting import PATIENCE, eventually

PAGES = 20
BETWEEN = 0.05, 0.3  # [s] from the acceptance of a goal to its stop
ROW = "p50", "p75", "worst"
WITHIN = 20.0  # bar: [ms] between the medians


def serve(closing: ExitStack, chain: Chain) -> tuple[str, str]:
    """Starts a panel; returns its address, and the cookie of an operator."""
    people, log = chain.folder / "people.yaml", chain.folder / "panel.log"
    people.write_text(f"people: [{{name: a, role: operator, token: {digest_of('t')}}}]")
    words = ["panel", "--connect", chain.endpoint, "--listen", "127.0.0.1:0", "--people", str(people)]
    out = closing.enter_context(log.open("w"))
    environment = {**os.environ, "STATE_DIRECTORY": str(chain.folder)}
    panel = subprocess.Popen([sys.executable, "-m", "hyperbit", *words], stdout=out, stderr=out, env=environment)
    closing.callback(panel.wait, PATIENCE)
    closing.callback(panel.terminate)
    url = eventually(lambda: re.findall(r"http://\S+", log.read_text()))[0]
    answer = httpx2.post(f"{url}session", json={"token": "t"}, headers={"origin": url.rstrip("/")})
    return url, answer.headers["set-cookie"].partition(";")[0]


def page(closing: ExitStack, chain: Chain, url: str, cookie: str) -> ClientConnection:
    """Opens the arm's page, and reads what it gets."""
    live, headers = f"{url.replace('http', 'ws')}arms/{chain.name}/live", {"cookie": cookie}
    socket = connect(live, origin=url.rstrip("/"), additional_headers=headers)  # type: ignore[arg-type]
    closing.callback(socket.close)
    threading.Thread(target=lambda: [None for _ in socket], daemon=True).start()
    return socket


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
        before, began = len(client.heard["state"]), time.monotonic()
        if kind == "page":
            live.send(json.dumps({"do": "stop", "n": k}))
        else:
            client.ask("stop")
        client.wait_for("stopped", after=before)
        spans[kind].append((began, time.monotonic()))
        client.reset()
    return spans


def last(syncs: NDArray[np.float64], began: float, heard: float) -> float:
    """Returns the time from a stop to the last SYNC before the state was heard [s]; 0 if none came after the stop."""
    k = int(np.searchsorted(syncs, heard)) - 1
    return max(float(syncs[k]) - began, 0.0) if k >= 0 else 0.0


def main() -> None:
    given, shares = CommandLine(__doc__, stops=30, seconds=20.0).parse(), dict[str, list[float]]()
    with Chain(travel_time=0.01, inrush=1) as chain, ExitStack() as closing:
        url, cookie = serve(closing, chain)
        client, live = chain.client(), page(closing, chain, url, cookie)
        time.sleep(1.0)
        spans, planner = stop_often(client, live, given.stops), chain.processes["planner"].pid
        for count in (0, PAGES, 0, PAGES):
            with ExitStack() as pages:
                for _ in range(count):
                    page(pages, chain, url, cookie)
                time.sleep(2.0)
                before = processor_time(planner)
                time.sleep(given.seconds)
                share = (processor_time(planner) - before) / given.seconds
            shares.setdefault(f"{count + 1} pages", []).append(round(100 * share, 2))
        real_time = client.diagnosed()["real_time"]
    syncs = chain.records["syncs"]["at"]
    to_last = {kind: [last(syncs, *span) for span in own] for kind, own in spans.items()}
    heard = {kind: [b - a for a, b in own] for kind, own in spans.items()}
    medians = {kind: 1e3 * statistics.median(times) for kind, times in to_last.items()}
    figures = {
        "SYNCs of the goals apart [ms]": round(1e3 * float(np.median(np.diff(syncs))), 2),
        "to the last SYNC [ms]": {kind: percentiles(times, *ROW) for kind, times in to_last.items()},
        "no SYNC after the request": {kind: sum(time == 0.0 for time in times) for kind, times in to_last.items()},
        "until stopped is heard [ms]": {kind: percentiles(times, *ROW) for kind, times in heard.items()},
        "processor of the planner [%]": shares,
        "real_time": real_time,
    }
    bars = {f"medians within {WITHIN:g} ms": abs(medians["page"] - medians["command"]) <= WITHIN}
    report(figures, bars, given.json)


if __name__ == "__main__":
    main()
