"""filterpy's Kalman filter, imported without scipy.

filterpy imports parts of scipy that this filter and this noise do not use, as for likelihoods. The imports would cost
each planner 74 MiB and more than a second. While filterpy is imported, empty modules replace them.

filterpy has no option against these imports. A lazy module of importlib would not help: filterpy imports names from
scipy, which loads the modules.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

UNUSED = "scipy.linalg", "scipy.ndimage", "scipy.sparse", "scipy.sparse.linalg", "scipy.stats"


def kalman_filter(states: int, measured: int) -> Any:
    """Returns a filterpy.kalman.KalmanFilter with numbers of states and of measured coordinates."""
    return imported("filterpy.kalman").KalmanFilter(states, measured)


def white_noise(dimension: int, time: float, variance: float) -> Any:
    """Returns the covariance (2d, 2d) that white-noise acceleration adds to states [p; v] in a time [s]."""
    discrete = imported("filterpy.common").Q_discrete_white_noise
    return discrete(2, dt=time, var=variance, block_size=dimension, order_by_dim=False)


class StandIn(ModuleType):
    """A module of scipy whose functions do not work."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return SimpleNamespace(logpdf=unavailable)


def imported(name: str) -> ModuleType:
    """Returns a module of filterpy; modules of scipy stay unimported unless other code has imported them."""
    if name not in sys.modules:
        stand_ins = {unused: StandIn(unused) for unused in UNUSED if unused not in sys.modules}
        sys.modules.update(stand_ins)
        try:
            __import__(name)
        finally:
            for unused in stand_ins:
                del sys.modules[unused]
    return sys.modules[name]


def unavailable(*_: object, allow_singular: bool) -> None:
    """Replaces multivariate_normal.logpdf, which filterpy calls once at its import."""
