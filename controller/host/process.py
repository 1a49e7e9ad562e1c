"""Events and actions of both cores, planner and executor: the end of the process, systemd and the log."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Quit(NamedTuple):
    pass


class Notify(NamedTuple):
    """An assignment for systemd, e.g. "READY=1"."""

    text: str


class Log(NamedTuple):
    """A line of the log, with a level of the module logging, and fields for the journal."""

    level: int
    text: str
    fields: Mapping[str, str] = MappingProxyType({})
