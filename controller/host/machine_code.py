"""The machine code of the kernels: its folder, chosen when numba is first imported, and damaged or missing files of it.

numba refuses to compile a kernel if it finds no folder for its machine code: a read-only installation, and a user
without a home, for example. A temporary folder takes its place then.
"""

import contextlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

from hyperbit.controller.host.folders import private_folder, user_folder, writable

VARIABLE = "NUMBA_CACHE_DIR"
PACKAGE = Path(__file__).parents[1]
told = list[str]()  # sentences for the user, each told once
REFUSAL = "no locator available"  # in numba's error, if it finds no folder
ADVICE = f"set {VARIABLE} to a folder that you can write"


def usual_folders() -> list[Path]:
    named = os.environ.get(VARIABLE)
    home = user_folder("XDG_CACHE_HOME", ".cache")
    return [*([Path(named)] if named else []), Path(__file__).parent / "__pycache__", home / "numba"]


def choose(folders: Iterable[Path]) -> str | None:
    """Makes numba use a temporary folder if none of its usual ones is writable; returns a sentence on this, or None.

    A read-only installation whose kernels are compiled needs no folder.
    """
    tried = list(folders)
    if any(writable(folder) for folder in tried) or any(PACKAGE.rglob("__pycache__/*.nbi")):
        return None
    refused = f"numba cannot write its machine code to {', '.join(map(str, tried))}"
    if (folder := private_folder("numba")) is None:
        return f"{refused}, and no temporary folder can be written: {ADVICE}"
    os.environ[VARIABLE] = str(folder)
    return f"{refused}; it goes to {folder}, where it may be deleted. To keep it, {ADVICE}"


class FirstImport:
    """A finder of modules: it chooses the folder before the first import of numba, and then changes numba's cache."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name == "numba" and (sentence := choose(usual_folders())) is not None:
            sys.stderr.write(f"{sentence}\n")
        if name != "numba.core.caching":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def executed(module: ModuleType) -> None:
                execute(module)
                module.Cache._guard_against_spurious_io_errors = forgiving
                module._CacheLocator.ensure_cache_path = usable(module._CacheLocator.ensure_cache_path)

            spec.loader.exec_module = executed  # type: ignore[method-assign]
        return spec


def usable(ensure: Callable[[Any], None]) -> Callable[[Any], None]:
    """Returns numba's check of a folder, which also accepts a read-only folder that has machine code."""

    def check(locator: Any) -> None:
        try:
            ensure(locator)
        except OSError:
            if not any(Path(locator.get_cache_path()).glob("*.nbi")):
                raise

    return check


@contextlib.contextmanager
def forgiving(cache: Any) -> Iterator[None]:
    """Around each access of numba to its files: what cannot be read is compiled, what cannot be written is not kept.

    The index of a damaged file is deleted, so that the code is kept again.
    """
    try:
        yield
    except OSError as error:
        if not told:
            told.append(f"numba cannot keep its machine code: {error}; it is compiled again at each start")
            sys.stderr.write(f"{told[0]}\n")
    except Exception:
        with contextlib.suppress(OSError, AttributeError):
            os.unlink(cache._cache_file._index_path)


def watch() -> None:
    """Makes the first import of numba choose the folder. A second call does nothing."""
    if "numba" not in sys.modules and not any(isinstance(finder, FirstImport) for finder in sys.meta_path):
        sys.meta_path.insert(0, FirstImport())
