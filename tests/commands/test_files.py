"""Files that users name: what is no file, or has no end, is refused in a sentence, and nothing waits for it."""

from __future__ import annotations

import os

import pytest

from tests.commands.conftest import ARM

READERS = {
    "arm": ("check", "FILE"),
    "wiring": ("check", str(ARM), "--eds", "FILE"),
    "goals": ("plan", str(ARM), "--goals", "FILE"),
    "goal": ("send", "planar16", "FILE"),
    "obstacles": ("obstacles", "planar16", "FILE"),
    "samples": ("calibrate", str(ARM), "FILE"),
    "people": ("panel", "--people", "FILE"),
    "Zenoh": ("stop", "planar16", "--zenoh", "FILE"),
    "recording": ("replay", "FILE"),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["directory", "device", "pipe"])
def test_what_is_no_file_is_refused(told, tmp_path, name, kind):
    path = tmp_path / "file"
    match kind:
        case "directory":
            path.mkdir()
        case "device":
            path.symlink_to("/dev/zero")
        case "pipe":
            os.mkfifo(path)
    words = [str(path) if word == "FILE" else word for word in READERS[name]]
    assert f"{path}: cannot be read: it is a {kind}, no file" in told(*words, code=2).replace("\n", " ")


@pytest.mark.parametrize("name", [name for name in READERS if name != "recording"])
def test_a_file_without_an_end_is_refused(told, tmp_path, name):
    path = tmp_path / "file"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    words = [str(path) if word == "FILE" else word for word in READERS[name]]
    assert "MB, the most for such a file; is it the right file?" in told(*words, code=2).replace("\n", " ")
