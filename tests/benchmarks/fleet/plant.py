"""A plant on one computer: router, arms with simulated boards, two pages and a recorder, each a process of its own."""

import contextlib
import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import httpx2
import yaml
import zenoh
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from hyperbit.controller.network import session
from hyperbit.controller.panel.access.people import digest_of
from tests.benchmarks.harness import PAPER_ARM, processor_time
from tests.endpoints import free_endpoint
from tests.waiting import eventually

OUTPUTS = 24  # of a board; few boards for an arm are light to simulate
PATIENT = {"heartbeat": 0.5, "heartbeat_timeout": 10.0, "boot_timeout": 6.0, "settle_margin": 5.0, "on_loss": "hold"}
PATIENCE = 900.0  # [s] on a machine with more arms than it can bear: there the start of an arm takes minutes


class Cost(NamedTuple):
    """What a process costs: processor time so far [s], and memory, shared pages in parts [MB]."""

    seconds: float
    memory: float


class Plant:
    def __init__(self, folder: Path, closing: ExitStack) -> None:
        self._folder, self._closing = folder, closing
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self.endpoint, self.arms = free_endpoint(), list[str]()
        closing.callback(self._end)
        self.start_router()

    def start_router(self) -> None:
        self._spawn("router", ["router", "--listen", self.endpoint])
        self.session().close()  # type: ignore[no-untyped-call]

    def session(self) -> zenoh.Session:
        def opened() -> zenoh.Session | None:
            try:
                return zenoh.open(session.configuration("client", connect=self.endpoint))
            except zenoh.ZError:
                return None

        return eventually(opened, PATIENCE, self._logs)

    def add_arm(self) -> str:
        name = f"arm{len(self.arms) + 1}"
        document = yaml.safe_load(PAPER_ARM.read_text()) | {"name": name, "boards": PATIENT}
        for k, channel in enumerate(document["actuators"]):
            channel["node"], channel["output"] = 1 + k // OUTPUTS, k % OUTPUTS
            channel["input"] = channel["output"]
        (self._folder / f"{name}.yaml").write_text(yaml.safe_dump(document))
        self.arms.append(name)
        self.start_arm(name)
        return name

    def start_arm(self, name: str) -> None:
        self._spawn(name, ["run", str(self._folder / f"{name}.yaml"), "--simulate", "--connect", self.endpoint])

    def same_name(self, name: str) -> str:
        """Starts a second daemon of an arm; returns what it says when it ends by itself."""
        words = [sys.executable, "-m", "hyperbit", "run", str(self._folder / f"{name}.yaml"), "--simulate"]
        other = self._folder / "other"
        other.mkdir(exist_ok=True)
        environment = {**os.environ, "STATE_DIRECTORY": str(other), "RUNTIME_DIRECTORY": str(other)}
        done = subprocess.run(
            [*words, "--connect", self.endpoint],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
        assert done.returncode != 0, f"a second {name} runs: {done.stderr[-500:]}"
        return done.stderr.strip().splitlines()[-1]

    def start_page(self, number: int) -> None:
        """Starts a panel, and opens its page of the first arm."""
        people, name = self._folder / "people.yaml", f"page{number}"
        people.write_text(f"people: [{{name: a, role: operator, token: {digest_of('t')}}}]")
        words = ["panel", "--connect", self.endpoint, "--listen", "127.0.0.1:0", "--people", str(people)]
        self._spawn(name, words)
        url = eventually(lambda: re.findall(r"http://\S+", self._log(name)), PATIENCE, self._logs)[0]
        answer = httpx2.post(f"{url}session", json={"token": "t"}, headers={"origin": url.rstrip("/")})
        cookie = answer.headers["set-cookie"].partition(";")[0]
        live = eventually(lambda: self._page(url, cookie), PATIENCE, self._logs)
        self._closing.callback(live.close)
        threading.Thread(target=drain, args=(live,), daemon=True).start()

    def start_recorder(self) -> None:
        self._spawn("recorder", ["record", self.arms[0], "--connect", self.endpoint])

    def kill(self, names: Sequence[str]) -> None:
        for name in names:
            for pid in session_of(self._processes[name].pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self._processes[name].wait()

    def stall(self, name: str) -> None:
        self._processes[name].send_signal(signal.SIGSTOP)

    def go_on(self, name: str) -> None:
        self._processes[name].send_signal(signal.SIGCONT)

    def costs(self, names: Sequence[str]) -> list[Cost]:
        return [sum_of([cost(pid) for pid in session_of(self._processes[name].pid)]) for name in names]

    def ledgers(self) -> dict[str, list[str | None]]:
        """Returns the ends of each goal in the ledgers of all arms: one for each time that the goal was accepted."""
        found: dict[str, list[str | None]] = {}
        for path in self._folder.glob("arm*/simulated/*.sqlite"):
            with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as ledger:
                for goal, status in ledger.execute("SELECT id, status FROM goals"):
                    found.setdefault(goal, []).append(status)
        return found

    def ready(self, name: str) -> bool:
        assert self._processes[name].poll() is None, f"{name} has ended: {self._log(name)[-500:]}"
        return f"serving the arm {name}" in self._log(name)

    def _page(self, url: str, cookie: str) -> ClientConnection | None:
        try:
            return connect(
                f"{url.replace('http', 'ws')}arms/{self.arms[0]}/live",
                origin=url.rstrip("/"),
                additional_headers={"cookie": cookie},
                ping_interval=None,  # a busy computer answers late, and the page stays open all the same
            )  # type: ignore[arg-type]
        except OSError:
            return None

    def _spawn(self, name: str, words: Sequence[str]) -> None:
        own = self._folder / name
        own.mkdir(exist_ok=True)
        environment = {**os.environ, "STATE_DIRECTORY": str(own), "RUNTIME_DIRECTORY": str(own), "NOTIFY_SOCKET": ""}
        with (own / "log").open("wb") as log:
            self._processes[name] = subprocess.Popen(
                [sys.executable, "-m", "hyperbit", *words],
                cwd=own,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def _log(self, name: str) -> str:
        return (self._folder / name / "log").read_text()

    def _logs(self) -> str:
        return json.dumps({name: self._log(name)[-300:] for name in self._processes}, indent=1)

    def _end(self) -> None:
        for name in reversed(self._processes):
            if self._processes[name].poll() is None:
                self.go_on(name)
                self._processes[name].terminate()
        for process in self._processes.values():
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()  # the kernel then ends its executor
                process.wait()


def drain(live: ClientConnection) -> None:
    with contextlib.suppress(ConnectionClosed):
        for _ in live:
            pass


def session_of(leader: int) -> list[int]:
    """Returns the processes of a session; an executor has a process group of its own there."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended
        if int(fields[3]) == leader:
            found.append(int(path.parent.name))
    return found


def cost(pid: int) -> Cost:
    try:
        kilobytes = re.search(r"^Pss: +(\d+)", Path(f"/proc/{pid}/smaps_rollup").read_text(), re.MULTILINE)
        return Cost(processor_time(pid), int(kilobytes[1]) / 1e3 if kilobytes else 0.0)
    except OSError:
        return Cost(0.0, 0.0)


def sum_of(costs: Sequence[Cost]) -> Cost:
    return Cost(sum(it.seconds for it in costs), sum(it.memory for it in costs))
