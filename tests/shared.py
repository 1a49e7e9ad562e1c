"""What all processes of the tests share: they are forked from one, see forks.py."""

import atexit
import functools
import os
import shutil
import tempfile
from pathlib import Path


@functools.cache
def shared_folder() -> Path:
    """Returns a folder of this process and of those that it forks, with the tables of arms in `cache`."""
    folder, creator = Path(tempfile.mkdtemp(prefix="hb")), os.getpid()  # with a short name, because of the sockets

    def remove() -> None:
        if os.getpid() == creator:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder
