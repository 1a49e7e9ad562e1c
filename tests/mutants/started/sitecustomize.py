"""Plants a defect when its module is imported. Python imports this file at the start of processes that tests start."""

import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import CodeType, ModuleType

MUTANT = (
    "HYPERBIT_MUTANT"  # environment variable: JSON of the module's name, its path and the path of its mutated source
)


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, name: str, path: str, source: str) -> None:
        super().__init__(name, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        return compile(self._source, self.path, "exec", dont_inherit=True)


class _Finder(importlib.abc.MetaPathFinder):
    def __init__(self, name: str, path: str, source: str) -> None:
        self._name, self._path, self._source = name, path, source

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._name:
            return None
        loader = _Loader(fullname, self._path, self._source)
        return importlib.util.spec_from_file_location(fullname, self._path, loader=loader)


def plant(name: str, path: str, source: str) -> None:
    """Makes the next import of a module take another source."""
    if name in sys.modules:
        raise RuntimeError(f"{name} is already imported: no defect can be planted in it")
    sys.meta_path.insert(0, _Finder(name, path, source))


if MUTANT in os.environ:
    _name, _path, _source = json.loads(os.environ[MUTANT])
    plant(_name, _path, Path(_source).read_text())
