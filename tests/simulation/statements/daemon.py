"""All statements on what clients see."""

from __future__ import annotations

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.executor.arm.arm import ExecutedArm
from tests.simulation.statements import clients, results, states
from tests.simulation.statements.exchange import Exchange
from tests.simulation.statements.mechanics import Mechanics
from tests.simulation.statements.statement import Statement
from tests.simulation.whole.configurations import Configurations

OF_CLIENTS = (
    clients.NothingBeginsAfterAClientsStop,
    clients.EachGoalHasOneResult,
    clients.EachRequestHasOneAnswer,
    clients.MessagesKeepTheirOrder,
    clients.OnlyFreshSetpointsAreFollowed,
    clients.CalmMeansReady,
    clients.OneFaultIsTold,
    clients.NoInternalError,
)
OF_THE_ARM = (
    results.ResultsAreTrue,
    results.MarksComeInOrder,
    results.BoundsAreTrue,
    states.StatesAreTrue,
    states.ToldNumbersNeverFall,
    states.NoStageTouchesAnObstacle,
)


def statements_of_clients(
    exchange: Exchange, executed: ExecutedArm, arm: Arm, space: Configurations
) -> list[Statement]:
    mechanics = Mechanics(arm, executed.actuators, space)
    return [*(kind(exchange) for kind in OF_CLIENTS), *(kind(exchange, mechanics) for kind in OF_THE_ARM)]
