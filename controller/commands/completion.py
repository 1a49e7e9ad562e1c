"""Completion in the shell: arms by name and file, actuators by label. A daemon that is not there completes nothing."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

from hyperbit.controller.commands import CONNECT, ENDPOINT

TIMEOUT = 1.0  # [s] for the answer of a daemon


def complete_arms(ctx: Any, incomplete: str) -> list[str]:
    """Returns the names of the arms that have a daemon, and the arms' files, that begin with a text."""
    from hyperbit.controller.commands.connection import arms_alive, open_session

    names = list[str]()
    with contextlib.suppress(Exception), open_session(*network_of(ctx)) as session:
        names = arms_alive(session)
    return [name for name in (*names, *complete_files(ctx, incomplete)) if name.startswith(incomplete)]


def complete_files(ctx: Any, incomplete: str) -> list[str]:
    """Returns the YAML files and the folders that begin with a text."""
    path = Path(incomplete)
    folder = path if incomplete.endswith("/") else path.parent
    found = list[str]()
    with contextlib.suppress(OSError):
        for each in sorted(folder.iterdir()):
            if each.is_dir() and not each.name.startswith("."):
                found.append(f"{each}/")
            elif each.suffix in (".yaml", ".yml"):
                found.append(str(each))
    return [name for name in found if name.startswith(incomplete)]


def complete_changes(ctx: Any, incomplete: str) -> list[str]:
    """Returns "ACTUATOR=STATE" for each actuator of the arm of a command line that begins with a text."""
    from hyperbit.controller.armfile.locks import STATES

    states = STATES if ctx.info_name == "jog" else (*STATES, "free")
    earlier = ctx.params.get("changes") or ("=contracted",)
    if earlier[-1] == "=" or ("=" not in earlier[-1] and not incomplete):  # bash divides "5.left=extended" at "="
        return [state for state in states if state.startswith(incomplete)]
    label, equals, _ = incomplete.partition("=")
    labels = list[str]()
    with contextlib.suppress(Exception):  # the arm is not there, or its file is wrong: nothing is completed
        labels = [each for each in actuators_of(ctx) if each.startswith(label)]
    if not equals and len(labels) > 1:
        return [f"{each}=" for each in labels]
    return [word for each in labels for state in states if (word := f"{each}={state}").startswith(incomplete)]


def actuators_of(ctx: Any) -> list[str]:
    arm = str(ctx.params["arm"])
    if arm.endswith((".yaml", ".yml")):
        from hyperbit.controller.armfile.actuators import read_wired

        return list(read_wired(Path(arm))[1])
    from hyperbit.controller.commands.connection import connected

    with connected(arm, *network_of(ctx)) as client:
        return list(client.request("arm", timeout=TIMEOUT)["actuators"])


def network_of(ctx: Any) -> tuple[str, Path | None]:
    """Returns endpoint and Zenoh file of a command line."""
    return ctx.params.get("connect") or os.environ.get(CONNECT) or ENDPOINT, ctx.params.get("zenoh_file")
