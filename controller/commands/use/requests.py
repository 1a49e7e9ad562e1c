"""Commands that send one request without content to a running daemon: cancel, stop and reset."""

from __future__ import annotations

from controller.commands.common import ENDPOINT, ArmName, AsJson, Connect, ZenohFile
from controller.commands.connection import ask, connected


def cancel(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Cancel the running goal or stream of set-points; the arm holds and accepts the next goal."""
    with connected(arm, connect, zenoh_file, find=False) as client:
        ask(client, arm, "cancel", {}, as_json)


def stop(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Stop the arm: it holds and accepts no motion until reset. No substitute for a switch that cuts the power."""
    with connected(arm, connect, zenoh_file, find=False) as client:
        ask(client, arm, "stop", {}, as_json)


def reset(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Leave a stop or a fault. Nothing moves."""
    with connected(arm, connect, zenoh_file) as client:
        ask(client, arm, "reset", {}, as_json)
