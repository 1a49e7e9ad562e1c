"""filterpy's Kalman filter, imported without scipy.stats.

filterpy imports scipy.stats for likelihoods, which hyperbit does not ask for: 58 MiB and more than a second of every
planner. While filterpy is imported, a module without content stands in its place.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

STATS = "scipy.stats"


def kalman_filter(states: int, measured: int) -> Any:
    """Returns a filterpy.kalman.KalmanFilter of so many states and measured coordinates."""
    return imported("filterpy.kalman").KalmanFilter(states, measured)


def white_noise(dimension: int, time: float, variance: float) -> Any:
    """Returns the covariance (2d, 2d) that white noise for acceleration adds to states [p; v] in a time [s]."""
    discrete = imported("filterpy.common").Q_discrete_white_noise
    return discrete(2, dt=time, var=variance, block_size=dimension, order_by_dim=False)


def imported(name: str) -> ModuleType:
    """Returns a module of filterpy, and leaves scipy.stats unimported, unless somebody else has imported it."""
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
    """Stands for multivariate_normal.logpdf, which filterpy tries at its import; likelihoods are not available."""
