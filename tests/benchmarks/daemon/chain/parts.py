"""The parts of a running arm, each a process of its own: boards, executor, planner; and what they recorded."""

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
from tests.benchmarks.daemon.chain import records
from tests.conftest import PAPER_ARM
from tests.endpoints import free_endpoint
from tests.system.stack.observer import Observer
from tests.waiting import eventually

ROOT = Path(__file__).parents[4]
ENDING = 20.0  # [s] for a process to end in order


class Parts:
    """The arm of the paper, running; the parts end with the context, and then their records can be read.

    Args:
        simulate: the boards are simulated in the executor's process, else in one of their own on an emulated bus.
    """

    def __init__(self, *, real_time: bool = False, simulate: bool = False, **fields: Any) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="hb"))
        self._simulate, self._closing = simulate, ExitStack()
        self.processes: dict[str, subprocess.Popen[str]] = {}
        (self.folder / "can").mkdir()
        document = yaml.safe_load(PAPER_ARM.read_text()) | fields
        document["buses"] = [{"name": "can0", "interface": "virtual", "channel": str(self.folder / "can")}]
        document |= {"real_time": {}} if real_time else {}
        if simulate:  # under load the executor may stand still for longer than the product's boards bear
            document["boards"] = {**document["boards"], "heartbeat_timeout": 10.0}
        self.name, self.file = str(document["name"]), self.folder / "arm.yaml"
        self.file.write_text(yaml.safe_dump(document))
        self.endpoint = free_endpoint()

    def __enter__(self) -> "Parts":
        """Starts all, and waits until the planner takes goals."""
        try:
            if not self._simulate:
                print("boards:", self.start("boards", self.folder / "can", self.file, said=True))
            path = self.folder / "executor.sock"
            self.start("executor", self.file, "--socket", path, *["--simulate"] * self._simulate)
            ledger = self.folder / "ledger.sqlite"
            words = ["--listen", self.endpoint, "--ledger", ledger, *["--simulate"] * self._simulate]
            self.start("planner", self.file, "--socket", path, *words)
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
        self._kept = {path.stem: records.read(path) for path in self.folder.glob("*.npz")}
        if error is None and all(process.returncode == 0 for process in self.processes.values()):
            shutil.rmtree(self.folder)
        else:
            print(f"the logs are in {self.folder}", file=sys.stderr)

    def start(self, module: str, *arguments: object, said: bool = False) -> str:
        """Starts a module of this package; returns the first line that it prints, if that is to be waited for."""
        environment = {"STATE_DIRECTORY": str(self.folder), "NOTIFY_SOCKET": ""}
        command = [sys.executable, "-m", f"{__package__}.{module}", str(self.folder), *map(str, arguments)]
        with (self.folder / f"{module}.log").open("w") as log:
            process = subprocess.Popen(
                command,
                cwd=ROOT,
                env=os.environ | environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if said else log,
                stderr=log,
                text=True,
            )
        self.processes[module] = process
        return process.stdout.readline().strip() if process.stdout else ""

    def _check(self) -> None:
        for process in self.processes.values():
            assert process.poll() is None, f"process {process.args} has ended with {process.returncode}"

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

    def record(self, name: str) -> dict[str, NDArray[np.float64]]:
        return self._kept[name]
