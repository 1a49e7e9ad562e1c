"""The command `watch`: shows a running arm in the terminal."""

from __future__ import annotations

import contextlib
import math
import queue
import sys
import time
from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

from msgspec import UNSET
from rich.box import SIMPLE
from rich.console import Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from hyperbit.controller.armfile.units import unit_mark
from hyperbit.controller.commands import ENDPOINT, common
from hyperbit.controller.commands.arguments import ArmName, AsJson, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, arm_name, drawn, print_json
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.decoding.decoding import convert
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.network.endpoints import START

COLOURS = {"ready": "green", "executing": "cyan", "starting": "yellow", "fault": "red", "stopped": "red"}
LOOP = ("longest_period", "mean_work", "longest_work", "overruns")  # times of the executor's loop


def watch(arm: ArmName, connect: Connect = ENDPOINT, zenoh_file: ZenohFile = None, as_json: AsJson = False) -> None:
    """Show a running arm until Ctrl-C; print changes as lines in a pipe, and states with --json."""
    news: queue.SimpleQueue[tuple[str, dict[str, Any]]] = queue.SimpleQueue()
    with (
        connected(arm, connect, zenoh_file) as client,
        client.subscribe("state", lambda message: news.put(("state", message))),
        client.subscribe("diagnostics", lambda message: news.put(("diagnostics", message))),
        contextlib.suppress(KeyboardInterrupt),
    ):
        in_lines = as_json or not common.console.is_terminal
        described = Description() if as_json else client.describe()
        unit, last = unit_mark(described.unit), ""
        view = View(arm_name(arm), described.actuators, unit)
        with contextlib.ExitStack() as stack:
            live = None if in_lines else stack.enter_context(Live(view, console=common.console, auto_refresh=False))
            while True:
                try:
                    key, message = news.get(timeout=2.0)
                except queue.Empty:
                    if not client.alive():
                        raise CommandFailed(f"arm {arm_name(arm)!r}: its daemon is not running", START) from None
                    continue
                if as_json and key == "state":
                    print_json(message)
                    continue
                told = convert(message, State) if key == "state" else convert(message, Diagnostics)
                if live is None:
                    if isinstance(told, State) and (line := line_of(told, unit)) != last:
                        sys.stdout.write(f"{clock_of(told)} {line}\n")
                        sys.stdout.flush()
                        last = line
                    continue
                view.receive_message(told)
                if news.empty():
                    live.update(view, refresh=True)


def clock_of(state: State) -> str:
    return time.strftime("%H:%M:%S", time.localtime(state.stamp))


def line_of(state: State, unit: str) -> str:
    reason, *faults = reason_and_faults(state)
    simulated = " (simulated)" if state.simulated else ""
    return "; ".join([f"{state.mode}{simulated}: {reason}", f"tip {where_of(state, unit)}", *faults])


def where_of(state: State, unit: str) -> str:
    return "unknown" if state.tip is None else f"({', '.join(f'{x:.4f}' for x in state.tip.position)}){unit}"


def progress_of(state: State) -> str:
    """Returns reached waypoints and remaining time of the running goal; "" if none runs."""
    if (progress := state.progress) is None:
        return ""
    remaining = progress.ends - state.stamp
    left = f"{remaining:.1f} s left" if remaining >= 0 else f"{-remaining:.1f} s late"
    return f"{progress.reached} of {progress.waypoints} waypoints, {left}"


def reason_and_faults(state: State) -> list[str]:
    """Returns the reason of a state's mode, then its faults with their codes; a fault that is the reason comes once."""
    faults = {f"{fault.code}: {fault.message}": fault.message for fault in state.faults}
    reason = next((text for text, message in faults.items() if message == state.reason), state.reason)
    return list(dict.fromkeys([reason, *faults]))


class View:
    """Renders the latest state and diagnostics of an arm: its name, its actuators, and what follows a length."""

    def __init__(self, arm: str, actuators: Sequence[str], unit: str) -> None:
        self._arm, self._unit = arm, unit
        modules = [label.partition(".")[0] for label in actuators]
        self._firsts = {k for k in range(1, len(modules)) if modules[k] != modules[k - 1]}
        self._state: State | None = None
        self._diagnostics: Diagnostics | None = None

    def receive_message(self, message: State | Diagnostics) -> None:
        if isinstance(message, State):
            self._state = message
        else:
            self._diagnostics = message

    def __rich__(self) -> RenderableType:
        if (state := self._state) is None:
            return Text(f"waiting for the state of {self._arm} ...")
        parts = [self._summary(state), self._actuators(state)]
        parts += [Text(f"{fault.code}: {fault.message}", style="red") for fault in state.faults]
        if self._diagnostics is not None:
            parts.append(self._hardware(self._diagnostics))
        simulated = ", simulated" if state.simulated else ""
        return Panel(Group(*parts), title=Text(f"{self._arm}{simulated}  {clock_of(state)}"))

    def _summary(self, state: State) -> RenderableType:
        table = Table.grid(padding=(0, 2))
        table.add_row("mode", Text(state.mode, style=f"bold {COLOURS.get(state.mode, '')}"), state.reason)
        table.add_row("tip", where_of(state, self._unit), f"configuration {state.configuration or 'unknown'}")
        table.add_row("goal", state.goal or "none", progress_of(state))
        return table

    def _actuators(self, state: State) -> RenderableType:
        text = Text("actuators by module (base first, ")
        extended, contracted = drawn("▮", "#"), drawn("▯", "-")
        text.append(f"{extended} extended, {contracted} contracted, ").append("? unknown, ", style="yellow")
        text.append("red: not as commanded", style="red").append(")\n")
        for k, (wanted, is_) in enumerate(zip_longest(state.commanded or (), state.measured or ())):
            text.append(" " if k in self._firsts else "")
            style = "red" if wanted is not None and is_ is not None and wanted != is_ else "none"
            text.append(
                "?" if is_ is None else extended if is_ else contracted, style="yellow" if is_ is None else style
            )
        return text

    def _hardware(self, diagnostics: Diagnostics) -> RenderableType:
        names = ("bus", "state", "load (worst)", "sent", "received", "dropped", "errors tx/rx")
        buses = Table(*names, box=SIMPLE, padding=(0, 1, 0, 0), pad_edge=False)
        for bus in diagnostics.buses:
            load = f"{bus.load:.0%} ({bus.worst_case.load:.0%})"
            counts = [str(count) for count in (bus.tx_frames, bus.rx_frames, bus.dropped)]
            buses.add_row(bus.name, bus.state, load, *counts, f"{bus.tx_errors}/{bus.rx_errors}")
        faulty = [it for it in diagnostics.boards if it.state != "operational" or it.emergency]
        boards = Text(f"{len(diagnostics.boards) - len(faulty)} of {len(diagnostics.boards)} boards operational")
        for board in faulty:
            boards.append(f"\n{board.bus}/{board.node}: {board.state} {board.emergency or ''}", style="red")
        times = (getattr(diagnostics.loop, name) for name in LOOP)
        period, work, longest, overruns = (math.nan if time is UNSET else time for time in times)
        figures = Text(
            f"control loop: longest period {period * 1e3:.1f} ms, work {work * 1e3:.2f} ms"
            f" (longest {longest * 1e3:.2f}), {overruns:.0f} overruns\n"
            f"{diagnostics.switches} switches since start; ledger {diagnostics.ledger}"
        )
        return Group(buses, boards, figures)
