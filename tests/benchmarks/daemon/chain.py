"""A running arm whose parts are processes of their own: boards, executor and planner; and what they recorded."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import yaml
import zenoh
from numpy.typing import NDArray

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client
from tests.benchmarks.harness import PAPER_ARM
from tests.endpoints import free_endpoint
from tests.system.stack.observer import Observer
from tests.waiting import eventually

ROOT = Path(__file__).parents[3]
ENDING = 20.0  # [s] for a process to end in order


class Chain:
    """The arm of the paper, running with real-time priorities. Its records can be read after the context.

    Args:
        spread: whether the boards' heartbeats do not come together, as real crystals drift.
        polled: whether the bus has no file descriptor.
        fields: replace those of the arm's file.
    """

    def __init__(self, spread: bool = False, polled: bool = False, **fields: Any) -> None:
        self._spread, self.executor = ["spread"] * spread, "polled" if polled else "executor"
        self.folder, self._closing = Path(tempfile.mkdtemp(prefix="hb")), ExitStack()
        self.processes: dict[str, subprocess.Popen[str]] = {}
        (self.folder / "can").mkdir()
        document = yaml.safe_load(PAPER_ARM.read_text()) | {"real_time": {}} | fields
        document["buses"] = [{"name": "can0", "interface": "virtual", "channel": str(self.folder / "can")}]
        self.name, self.file = str(document["name"]), self.folder / "arm.yaml"
        self.file.write_text(yaml.safe_dump(document))
        self.endpoint = free_endpoint()

    def __enter__(self) -> "Chain":
        """Starts all, and waits until the arm is ready."""
        try:
            print("boards:", self.start("boards", self.folder / "can", self.file, *self._spread, said=True))
            socket, ledger = self.folder / "executor.sock", self.folder / "ledger.sqlite"
            self.start(self.executor, self.file, "--socket", socket)
            self.start("planner", self.file, "--socket", socket, "--listen", self.endpoint, "--ledger", ledger)
            client = self.client()
            eventually(lambda: client.state["mode"] == "ready" or self._check())
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._closing.close()
        for process in reversed(self.processes.values()):
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.records: dict[str, dict[str, NDArray[np.float64]]] = {}
        for path in self.folder.glob("*.npz"):
            with np.load(path) as file:
                self.records[path.stem] = {name: file[name] for name in file.files}
        if error is None and all(process.returncode == 0 for process in self.processes.values()):
            shutil.rmtree(self.folder)
        else:
            print(f"the logs are in {self.folder}", file=sys.stderr)

    def start(self, kind: str, *arguments: object, said: bool = False) -> str:
        """Starts a part; returns the first line that it prints, if that is to be waited for."""
        environment = {"STATE_DIRECTORY": str(self.folder), "NOTIFY_SOCKET": ""}
        with (self.folder / f"{kind}.log").open("w") as log:
            self.processes[kind] = process = subprocess.Popen(
                [sys.executable, "-m", "tests.benchmarks.daemon.parts", kind, str(self.folder), *map(str, arguments)],
                cwd=ROOT,
                env=os.environ | environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if said else log,
                stderr=log,
                text=True,
            )
        return process.stdout.readline().strip() if process.stdout else ""

    def session(self) -> zenoh.Session:
        def connect() -> zenoh.Session | None:
            self._check()
            try:
                return zenoh.open(session.configuration("client", connect=self.endpoint))
            except zenoh.ZError:
                return None

        return self._closing.enter_context(eventually(connect))

    def client(self) -> Observer:
        observer = Observer(Client(self.session(), self.name))
        eventually(lambda: observer.heard["state"])
        return observer

    def _check(self) -> None:
        for process in self.processes.values():
            assert process.poll() is None, f"process {process.args} has ended with {process.returncode}"
