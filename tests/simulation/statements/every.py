"""All statements."""

from __future__ import annotations

from types import ModuleType

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.executor.arm.arm import ExecutedArm
from tests.simulation.statements import (
    clients,
    containers,
    objects,
    pins,
    programs,
    requests,
    results,
    running,
    states,
    told,
)
from tests.simulation.statements.account import Account
from tests.simulation.statements.exchange import Exchange
from tests.simulation.statements.mechanics import Mechanics
from tests.simulation.statements.statement import Statement
from tests.simulation.whole.configurations import Configurations


def _of(*modules: ModuleType) -> tuple[type[Statement], ...]:
    """Returns the statements that modules define: each has a number."""
    own = [(module, kind) for module in modules for kind in vars(module).values() if isinstance(kind, type)]
    return tuple(
        kind
        for module, kind in own
        if issubclass(kind, Statement) and kind.number and kind.__module__ == module.__name__
    )


OF_THE_EXECUTOR = _of(pins, programs, requests, told, objects, running, containers)
OF_CLIENTS, OF_THE_ARM = _of(clients), _of(results, states)


def of_the_executor(account: Account) -> list[Statement]:
    return [kind(account) for kind in OF_THE_EXECUTOR]


def of_clients(exchange: Exchange, executed: ExecutedArm, arm: Arm, space: Configurations) -> list[Statement]:
    """Returns the statements on what clients see; `space` has all configurations of the arm."""
    mechanics = Mechanics(arm, executed.actuators, space)
    made: list[Statement] = [kind(exchange) for kind in OF_CLIENTS]  # type: ignore[arg-type]
    return [*made, *(kind(exchange, mechanics) for kind in OF_THE_ARM)]  # type: ignore[arg-type, call-arg]
