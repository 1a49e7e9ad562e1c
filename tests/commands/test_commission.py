"""The command commission, as a process with an executor of its own and simulated boards, whose wiring differs."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

ARM = """\
# an arm with comments
name: wired-{pid}
modules:
  - {{type: revolute, cylinders: [[0, 1], [0, 1]], link: {{position: [1, 0]}}}}
tolerance: {{position: 0.1}}
travel_time: 0.2  # of the maker
buses: [{{name: can0, channel: can0, interface: virtual}}]
actuators:
  - {{module: 1, actuator: "1", bus: can0, node: 1, output: {a}, input: 0}}  # the first
  - module: 1
    actuator: "2"
    bus: can0
    node: 1
    output: {b}  # the second
    input_contracted: {end}
"""


def commission(folder: Path, answers: str, *words: str) -> tuple[int, str]:
    command = [sys.executable, "-m", "hyperbit", "commission", "arm.yaml", "--watch", "0.3"]
    own = {**os.environ, "XDG_RUNTIME_DIR": str(folder), "HOME": str(folder)}
    ran = subprocess.run([*command, *words], cwd=folder, input=answers, capture_output=True, text=True, env=own)
    return ran.returncode, ran.stdout + ran.stderr


def test_bad_input_is_named_before_anything_moves(tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_text(ARM.format(pid=os.getpid(), a=0, b=1, end=1))
    code, told = commission(tmp_path, "", "9.left")
    assert (code, "'9.left' is no actuator of this arm, which has 1.1 to 1.2" in told) == (2, True), told
    (tmp_path / "arm.commission.json").write_text("{")
    code, told = commission(tmp_path, "x\n\nup\nq\n", "--simulate")
    assert code == 1, told
    assert "'x' is no answer: Enter extend, q leave" in told, told
    assert "'up' is no answer: e extended, c contracted, n nothing" in told, told
    assert list(tmp_path.glob("arm.commission.json.damaged-*"))


def test_the_socket_of_a_killed_executor_keeps_nobody_out(tmp_path: Path) -> None:
    (tmp_path / "arm.yaml").write_text(ARM.format(pid=os.getpid(), a=0, b=1, end=1))
    path = tmp_path / "hyperbit" / f"wired-{os.getpid()}.sock"
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as left:
        left.bind(str(path))
    code, told = commission(tmp_path, "q\n")
    assert (code, "the arm is fault: board can0/1 neither booted" in told) == (1, True), told
