"""The folder for the machine code of the kernels, chosen when numba is first imported.

numba refuses to compile a kernel if it finds no folder for its machine code: a read-only installation, and a user
without a home, for example. A temporary folder takes its place then.
"""

import os
import stat
import sys
from collections.abc import Iterable
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
REFUSAL = "no locator available"  # in numba's error, if it finds no folder
ADVICE = f"set {VARIABLE} to a folder that you can write"


def usual_folders() -> list[Path]:
    """Returns the folders that numba tries, in its order."""
    named = os.environ.get(VARIABLE)
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    return [*([Path(named)] if named else []), Path(__file__).parent / "__pycache__", home / "numba"]


def writable(folder: Path) -> bool:
    """Returns whether a folder exists or can be created, and accepts files; numba tests the same."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def private_folder() -> Path | None:
    """Returns a temporary folder that only this user can write, because it holds code; None if there is none."""
    import tempfile

    try:
        folder = Path(tempfile.gettempdir()) / f"hyperbit-numba-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if own and writable(folder) else None


def choose(folders: Iterable[Path]) -> str | None:
    """Makes numba use a temporary folder if none of its usual ones is writable; returns a sentence on this, or None."""
    tried = list(folders)
    if any(writable(folder) for folder in tried):
        return None
    refused = f"numba cannot write its machine code to {', '.join(map(str, tried))}"
    if (folder := private_folder()) is None:
        return f"{refused}, and no temporary folder can be written: {ADVICE}"
    os.environ[VARIABLE] = str(folder)
    return f"{refused}; it goes to {folder}, where it may be deleted. To keep it, {ADVICE}"


class FirstImport:
    """A module finder that finds nothing: it notices the first import of numba, and chooses the folder before."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        if name == "numba":
            sys.meta_path.remove(self)
            if (sentence := choose(usual_folders())) is not None:
                sys.stderr.write(f"{sentence}\n")


def watch() -> None:
    """Makes the first import of numba choose the folder. A second call does nothing."""
    if "numba" not in sys.modules and not any(isinstance(finder, FirstImport) for finder in sys.meta_path):
        sys.meta_path.insert(0, FirstImport())
