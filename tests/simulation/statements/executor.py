"""All statements on the executor's side."""

from __future__ import annotations

from tests.simulation.statements import containers, objects, pins, programs, requests, running, told
from tests.simulation.statements.account import Account
from tests.simulation.statements.statement import Statement

EVERY: tuple[type[Statement], ...] = (
    pins.PinsHaveACause,
    pins.AStopIsABarrier,
    pins.CoilsEndInTime,
    pins.CoilsComeOnByASync,
    pins.FewSwitchAtOnce,
    pins.NoStartChangesAPin,
    programs.AcceptedProgramsFit,
    programs.ValidProgramsRun,
    programs.OneResultEach,
    programs.DoneIsProven,
    programs.StrictStagesWait,
    programs.StagesBeginInTime,
    programs.NothingRunsWithoutItsPlanner,
    requests.OnlyTheWelcomeAct,
    requests.LocksAndResetsAreSound,
    requests.TrialsMoveOneActuator,
    told.SnapshotsAreTrue,
    told.SilentBoardsAreUnknown,
    told.CountsAreTheSwitches,
    told.ResultsCountTheirSwitches,
    told.NumbersNeverFall,
    told.EpochsEnd,
    objects.BoardObjects,
    running.HeartbeatsDoNotPause,
    running.DiagnosticsCome,
    running.NothingBeginsBesideAnOpenDoor,
    running.AnEndInOrderLeavesTheArmAtRest,
    running.ModesFollowOneAnother,
    running.NoDefect,
    containers.ContainersReturnToTheirSize,
)


def every_statement(account: Account) -> list[Statement]:
    return [kind(account) for kind in EVERY]
