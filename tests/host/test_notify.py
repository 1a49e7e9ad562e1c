"""Notifications to systemd, on a real socket."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.host.notify import FIRST, Notifier


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    name = str(tmp_path / "notify") if request.param == "path" else f"@hyperbit-test-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind("\0" + name[1:] if name.startswith("@") else name)
        listening.settimeout(30)
        monkeypatch.setenv("NOTIFY_SOCKET", name)
        yield listening


def test_an_assignment_goes_out_in_a_datagram(systemd: socket.socket) -> None:
    Notifier().notify("STATUS=ready: grün")
    assert systemd.recv(4096).decode() == "STATUS=ready: grün"


def test_a_line_break_begins_no_assignment(systemd: socket.socket) -> None:
    Notifier().notify("STATUS=goal a\nMAINPID=1\r\udc80")
    assert systemd.recv(4096) == b"STATUS=goal a MAINPID=1 ?"


def test_the_watchdogs_time_is_read(systemd: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    assert Notifier().watchdog is None
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    assert Notifier().watchdog == 2.0
    for wrong in ("", "²", "-1", "soon"):
        monkeypatch.setenv("WATCHDOG_USEC", wrong)
        assert Notifier().watchdog is None


def test_nobody_there_is_no_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    Notifier().notify("READY=1")
    monkeypatch.delenv("NOTIFY_SOCKET")
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    notifier = Notifier()
    notifier.notify("READY=1")
    assert notifier.watchdog is None


def test_a_full_socket_does_not_wait(systemd: socket.socket) -> None:
    notifier = Notifier()
    for _ in range(1000):
        notifier.notify("WATCHDOG=1")
    assert systemd.recv(4096) == b"WATCHDOG=1"


def test_systemd_gets_a_file_to_keep_and_gives_it_back(systemd: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    with Notifier().kept_file("counts") as file:
        file.write(b"7 switches")
        data, (kept,), _, _ = socket.recv_fds(systemd, 4096, 1)
    assert data == b"FDSTORE=1\nFDNAME=counts"
    monkeypatch.setenv("LISTEN_FDNAMES", "other:" * (kept - FIRST) + "counts")
    monkeypatch.setenv("LISTEN_PID", str(os.getpid()))
    with Notifier().kept_file("counts") as file:
        file.seek(0)
        assert (file.fileno(), file.read(), os.get_inheritable(kept)) == (kept, b"7 switches", False)


def test_files_for_another_process_are_not_taken(systemd: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LISTEN_FDNAMES", "counts")
    monkeypatch.setenv("LISTEN_PID", str(os.getpid() + 1))
    with Notifier().kept_file("counts") as file:
        assert file.read() == b""
    assert systemd.recv(4096).startswith(b"FDSTORE=1")


def test_without_systemd_no_file_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert Notifier().kept_file("counts") is None
