"""The cost of the page: a stop from it against the command's own request, and the planner with 20 pages open.

python -m tests.benchmarks.panel [--stops 30] [--seconds 20]

A stop's time ends when a client of its own hears the state `stopped`; its beginning is the request's first byte.
"""

import argparse
import json
import os
import queue
import re
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import zenoh
from websockets.sync.client import ClientConnection, connect

from controller.gateway import session
from controller.gateway.client import Client
from controller.panel.access import digest_of
from tests.keys import DEPLOY
from tests.waiting import PATIENCE, eventually

PAGES, ARM = 20, "planar16"


def started(closing: ExitStack, folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Runs a command of hyperbit until the measurement ends."""
    environment = {**os.environ, "RUNTIME_DIRECTORY": str(folder)}
    log = closing.enter_context((folder / f"{words[0]}.log").open("w"))
    process = subprocess.Popen(
        [sys.executable, "-m", "controller.cli", *words], stdout=log, stderr=log, env=environment
    )
    closing.callback(process.wait, PATIENCE)
    closing.callback(process.terminate)
    return process


def page(closing: ExitStack, url: str, cookie: str) -> ClientConnection:
    """Opens a page that reads all it is sent."""
    socket = connect(
        f"{url.replace('http', 'ws')}arms/{ARM}/live", origin=url.rstrip("/"), additional_headers={"cookie": cookie}
    )  # type: ignore[arg-type]
    closing.callback(socket.close)

    def read() -> None:
        for _ in socket:
            pass

    threading.Thread(target=read, daemon=True).start()
    return socket


def processor_time(process: subprocess.Popen[bytes]) -> float:
    """Processor time of a process so far [s]."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=20.0)
    wanted = parser.parse_args()
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory()))
        with socket.create_server(("127.0.0.1", 0)) as free:
            endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        (folder / "people.yaml").write_text(f"people: [{{name: a, role: operator, token: {digest_of('t')}}}]")
        ledger = str(folder / "ledger.sqlite")
        words = ("run", str(DEPLOY / f"{ARM}.yaml"), "--simulate", "--listen", endpoint, "--ledger", ledger)
        planner = started(closing, folder, *words)
        started(
            closing,
            folder,
            "panel",
            "--connect",
            endpoint,
            "--listen",
            "127.0.0.1:0",
            "--people",
            str(folder / "people.yaml"),
        )
        log = folder / "panel.log"
        url = eventually(lambda: re.findall(r"http://\S+", log.read_text()))[0]
        import httpx2

        answer = httpx2.post(f"{url}session", json={"token": "t"}, headers={"origin": url.rstrip("/")})
        cookie = answer.headers["set-cookie"].partition(";")[0]

        def opened() -> zenoh.Session:
            try:
                return zenoh.open(session.configuration("client", connect=endpoint))
            except zenoh.ZError:
                return None  # type: ignore[return-value]  # the planner is not there yet

        own = closing.enter_context(eventually(opened, every=0.5))
        client, modes = Client(own, ARM), queue.SimpleQueue[str]()
        client.subscribe("state", lambda state: modes.put(state["mode"]))

        def until(mode: str) -> float:
            while modes.get(timeout=PATIENCE) != mode:
                pass
            return time.perf_counter()

        until("ready")
        live = page(closing, url, cookie)
        time.sleep(1.0)
        times: dict[str, list[float]] = {"page": [], "command": []}
        for k in range(2 * wanted.stops):
            kind = ("page", "command")[k % 2]
            began = time.perf_counter()
            if kind == "page":
                live.send(json.dumps({"do": "stop", "n": k}))
            else:
                client.request("stop")
            times[kind].append(until("stopped") - began)
            client.request("reset")
            until("ready")
        for kind, seconds in times.items():
            low, middle, high = (1e3 * q for q in statistics.quantiles(seconds, n=4))
            print(f"stop by {kind}: median {middle:.1f} ms, quartiles {low:.1f} and {high:.1f}, {len(seconds)} stops")
        for count in (0, PAGES, 0, PAGES):
            with ExitStack() as pages:
                for _ in range(count):
                    page(pages, url, cookie)
                time.sleep(2.0)
                before = processor_time(planner)
                time.sleep(wanted.seconds)
                share = (processor_time(planner) - before) / wanted.seconds
            print(f"planner with {count + 1} pages: {100 * share:.1f} % of a processor")


if __name__ == "__main__":
    main()
