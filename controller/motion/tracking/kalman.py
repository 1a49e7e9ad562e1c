"""filterpy's Kalman filter, imported without scipy.stats.

filterpy imports scipy.stats to compute likelihoods, which hyperbit does not use. The import would cost each planner
58 MiB and more than a second. While filterpy is imported, an empty module replaces scipy.stats.

filterpy has no option against this import. A lazy module of importlib would not help: filterpy imports names from
scipy.stats, which loads the module.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

STATS = "scipy.stats"


def kalman_filter(states: int, measured: int) -> Any:
    """Returns a filterpy.kalman.KalmanFilter with numbers of states and of measured coordinates."""
    return imported("filterpy.kalman").KalmanFilter(states, measured)


def white_noise(dimension: int, time: float, variance: float) -> Any:
    """Returns the covariance (2d, 2d) that white-noise acceleration adds to states [p; v] in a time [s]."""
    discrete = imported("filterpy.common").Q_discrete_white_noise
    return discrete(2, dt=time, var=variance, block_size=dimension, order_by_dim=False)


def imported(name: str) -> ModuleType:
    """Returns a module of filterpy; scipy.stats stays unimported unless other code has imported it."""
    if name not in sys.modules and STATS not in sys.modules:
        stand_in = ModuleType(STATS)
        vars(stand_in).update(norm=None, multivariate_normal=SimpleNamespace(logpdf=unavailable))
        sys.modules[STATS] = stand_in
        try:
            __import__(name)
        finally:
            del sys.modules[STATS]
    __import__(name)
    return sys.modules[name]


def unavailable(*_: object, allow_singular: bool) -> None:
    """Replaces multivariate_normal.logpdf, which filterpy calls once at its import."""
