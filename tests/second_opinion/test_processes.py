"""The executor's process, on an emulated bus and on the kernel's, with boards of another stack in a thread."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from hyperbit.controller.program import Ended, Program, Snapshot, Stage, pack
from tests import vcan
from tests.emulated import Interface
from tests.executor.process.test_process import SIZE, Planner
from tests.second_opinion.board import MODULE, PLAIN, Board, Change, Kind
from tests.system.stack import arms
from tests.waiting import eventually

# The interface "virtual" of arms' files is the emulated one here.
RUN = """
import runpy, can, tests.emulated
can.interfaces.BACKENDS["virtual"] = "tests.emulated", "EmulatedBus"
runpy.run_module("hyperbit.controller.executor", run_name="__main__")
"""
ON_BOARD = 12  # actuators


class Boards:
    def __init__(self, bus: can.BusABC, kind: Kind) -> None:
        self.changes: list[Change] = []
        self._bus, self._ended = bus, threading.Event()
        nodes = range(1, SIZE // ON_BOARD + 1)
        self.boards = [Board(node, kind, self._send, self.changes.append) for node in nodes]
        self._thread = threading.Thread(target=self._run, name="boards")
        self._thread.start()

    @property
    def pins(self) -> int:
        return sum(board.pins << ON_BOARD * k for k, board in enumerate(self.boards))

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._bus.shutdown()

    def _send(self, cob_id: int, data: bytes) -> None:
        with contextlib.suppress(can.CanError):  # a full queue drops a frame, as on a real bus
            self._bus.send(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def _run(self) -> None:
        while not self._ended.is_set():
            message = self._bus.recv(0.005)
            now = time.monotonic()
            if message is not None and not (message.is_error_frame or message.is_remote_frame):
                for board in self.boards:
                    board.receive(message.arbitration_id, bytes(message.data), now)
            for board in self.boards:
                board.step(now)


def write_arm(folder: Path, bus: dict[str, Any], kind: Kind) -> Path:
    document = arms.planar()
    named = {**bus, "interface": bus["interface"].replace("emulated", "virtual")}
    document["buses"] = [{"name": "can0", **named}]
    for k, channel in enumerate(document["actuators"]):
        channel |= {"bus": "can0", "node": 1 + k // ON_BOARD, "output": k % ON_BOARD, "input": k % ON_BOARD}
    loss = {"on_loss": "contract"} if kind is MODULE else {"on_loss": "hold", "error_state": "device"}
    document["boards"] = {**arms.PATIENT, **arms.QUICK, **loss}
    path = folder / "planar16.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture(params=["emulated", "socketcan"])
def interface(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[dict[str, Any]]:
    only = {"virtual": "emulated"}.get(request.config.getoption("bus"), request.config.getoption("bus"))
    if only not in (None, request.param):
        pytest.skip(f"only on {only}")
    if request.param == "socketcan":
        if reason := vcan.missing():
            (pytest.fail if only else pytest.skip)(reason)
        with vcan.made() as made:
            yield {"interface": "socketcan", "channel": made.name}
        return
    folder = tmp_path / "can0"
    folder.mkdir()
    emulated = Interface(folder)
    yield {"interface": "emulated", "channel": emulated.channel}
    emulated.close()


@pytest.mark.parametrize("kind", [MODULE, PLAIN], ids=["contract", "device"])
def test_a_killed_executor_starts_again_and_no_start_changes_a_pin(
    interface: dict[str, Any], kind: Kind, tmp_path: Path
) -> None:
    boards = Boards(can.Bus(**interface, ignore_config=True), kind)
    command = [sys.executable, "-c", RUN, str(write_arm(tmp_path, interface, kind)), "--socket", str(tmp_path)]
    command += ["--journal", str(tmp_path / "journal")]
    processes = []

    def start() -> tuple[Planner, Snapshot]:
        processes.append(subprocess.Popen(command))
        planner = Planner(tmp_path / "planar16.sock")
        return planner, planner.wait(Snapshot, lambda message: message.mode == "ready")

    try:
        planner, ready = start()
        stages = (Stage(pack(0b111, SIZE), at=0.0, mark=0),)
        planner.send(Program(1, ready.epoch, ready.outputs, 0.0, stages, True, True, "goal 1"))
        assert planner.wait(Ended).status == "done"
        assert boards.pins == 0b111
        processes[0].kill()
        processes[0].wait()
        eventually(lambda: boards.pins == 0)
        planner, ready = start()
        assert (boards.pins, ready.outputs) == (0, pack(0, SIZE))
        energised = [change.cause for change in boards.changes if change.energised]
        assert set(energised) == {"SYNC"}
    finally:
        for process in processes:
            process.kill()
            process.wait()
        boards.close()
