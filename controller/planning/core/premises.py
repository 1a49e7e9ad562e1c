"""What plans are made from: arm, tables, obstacles and tip bias."""

from typing import NamedTuple

from hyperbit.controller.planning.core.arm import ExecutorView
from hyperbit.controller.planning.core.locks import Locks
from hyperbit.controller.planning.core.obstacles import ObstacleOwner
from hyperbit.controller.planning.core.tasks import Basis
from hyperbit.controller.planning.core.tip_bias import TipBiasEstimator


class Premises(NamedTuple):
    """The owners of what plans are made from."""

    view: ExecutorView
    locks: Locks
    obstacles: ObstacleOwner
    tip_bias: TipBiasEstimator | None  # None: the arm has no tracker

    def basis(self) -> Basis | None:
        """Returns what a plan made now holds for; None while the arm, its tables or the obstacles are not known."""
        state, tables, scene = self.view.state, self.locks.tables, self.obstacles.scene
        return None if state is None or tables is None or scene is None else Basis(state.start, tables, scene)

    def correction(self) -> tuple[float, ...] | None:
        """Returns the present tip bias as `dimension` numbers; None: no tracker."""
        return None if self.tip_bias is None else tuple(self.tip_bias.bias().tolist())
