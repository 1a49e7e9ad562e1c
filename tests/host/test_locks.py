"""Files that cannot be locked: the error names the file and a remedy."""

import errno
import fcntl
from pathlib import Path

import pytest

from hyperbit.controller.host.keeper import lock_file


def test_a_file_system_without_locks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(OSError, match=r"No locks available; .*name a folder on a local disk: '.*/a.lock'"):
        lock_file(tmp_path / "a.lock", "in use by")


@pytest.mark.parametrize(("number", "remedy"), [(errno.EACCES, "another user"), (errno.EROFS, "can be written")])
def test_a_folder_that_refuses_files_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, remedy: str
) -> None:
    def refuse(path: Path, *_: object, **__: object) -> None:
        raise OSError(number, "refused", str(path))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(OSError, match=rf"refused; .*{remedy}.*'{tmp_path}/folder'"):
        lock_file(tmp_path / "folder" / "a.lock", "in use by")
