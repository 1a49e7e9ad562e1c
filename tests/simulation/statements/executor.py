"""All statements on the executor's side."""

from __future__ import annotations

from tests.simulation.statements import pins
from tests.simulation.statements.account import Account
from tests.simulation.statements.statement import Statement

EVERY: tuple[type[Statement], ...] = (
    pins.PinsHaveACause,
    pins.AStopIsABarrier,
    pins.CoilsEndInTime,
    pins.CoilsComeOnByASync,
    pins.FewSwitchAtOnce,
    pins.NoStartChangesAPin,
)


def every_statement(account: Account) -> list[Statement]:
    return [kind(account) for kind in EVERY]
