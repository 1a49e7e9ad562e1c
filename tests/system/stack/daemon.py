"""A daemon with simulated boards, forked for a test."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from tests.endpoints import free_endpoint
from tests.shared import shared_folder
from tests.system.stack.processes import commands, tail
from tests.waiting import eventually


@contextmanager
def running(arm: Path, folder: Path) -> Iterator[str]:
    """Runs an arm with long time-outs until it is ready; yields its Zenoh endpoint. Its files are in the folder."""
    endpoint, file, log = free_endpoint(), patient_copy(arm, folder), folder / "log"
    words = ["run", str(file), "--simulate", "--listen", endpoint, "--ledger", str(folder / "ledger.sqlite")]
    folders = {"RUNTIME_DIRECTORY": str(folder), "XDG_CACHE_HOME": str(shared_folder() / "cache")}
    process = commands().start(words, log, folders)
    host, _, port = endpoint.removeprefix("tcp/").partition(":")

    def listens() -> bool:
        assert process.alive, tail(log)
        with suppress(OSError), socket.create_connection((host, int(port))):
            return True
        return False

    try:
        eventually(listens, told=lambda: tail(log))
        wait_until_ready(file, endpoint)
        yield endpoint
    finally:
        process.end()


def wait_until_ready(arm: Path, endpoint: str) -> None:
    with connected(str(arm), endpoint, None) as client:
        demo.wait_until_ready(client)
