"""Folders of users and services."""

import os
from pathlib import Path

import pytest

from hyperbit.controller.host.folders import state_folder
from hyperbit.controller.workspace.cache import default_directory


def no_home() -> Path:
    raise RuntimeError("Could not determine home directory.")


def test_a_user_without_a_home_has_temporary_folders(tmp_path, monkeypatch):
    for name in ("XDG_STATE_HOME", "XDG_CACHE_HOME", "STATE_DIRECTORY", "CACHE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    own = tmp_path / f"hyperbit-home-{os.getuid()}"
    assert state_folder() == own / ".local/state/hyperbit"
    assert default_directory() == own / ".cache/hyperbit"
    assert own.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(("service", "folder"), [("/a:/b", "/a"), ("", "/home/hyperbit")])
def test_a_service_has_its_own(monkeypatch, service, folder):
    monkeypatch.setenv("STATE_DIRECTORY", service)
    monkeypatch.setenv("XDG_STATE_HOME", "/home")
    assert state_folder() == Path(folder)
    assert state_folder(simulated=True) == Path(folder, "simulated")
