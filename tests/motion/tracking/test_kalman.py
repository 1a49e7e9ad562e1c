"""filterpy's filter without scipy.stats."""

import subprocess
import sys

PROGRAM = """
import sys
from hyperbit.controller.motion.tracking.kalman import kalman_filter, white_noise

filter = kalman_filter(4, 2)
assert filter.x.shape[0] == 4
assert white_noise(2, 0.1, 1.0).shape == (4, 4)
assert "scipy.stats" not in sys.modules
import scipy.stats
assert scipy.stats.norm.cdf(0.0) == 0.5
"""


def test_statistics_are_not_imported_and_can_be_imported_later() -> None:
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, timeout=100)


def test_a_module_that_is_imported_already_stays() -> None:
    subprocess.run([sys.executable, "-c", f"import scipy.stats, filterpy.kalman{PROGRAM}".replace(
        'assert "scipy.stats" not in sys.modules', "")], check=True, timeout=100)  # fmt: skip
