"""Inverse kinematics of arms made of many two-state actuators, as a Python library.

    import hyperbit as hb

    arm = hb.load("planar16.yaml")
    ik = hb.Solver(arm, obstacles=[hb.Disc((1.2, 2.0), 0.3)])
    solution = ik.solve(hb.Goal((0.55, 2.9), tolerance=2e-3), start=arm.home)
    print(solution.configuration, solution.switches, solution.certificate)
    path = ik.follow([hb.Goal((0.4, 2.9)), hb.Goal((0.5, 2.8))], start=solution)
    hb.plot(arm, path).savefig("path.png")

Units: lengths in the unit of the arm's description, angles in radians counter-clockwise, times in seconds. A
configuration is one integer for each module, base first, shape (B,). Every error is a subclass of `hyperbit.Error`.

Limits: `certificate` states how much a search has proven within its deadline. Densities count configurations in pixels
and are approximate. Between goals, the stages in which actuators switch are checked for collisions. A solver is not
thread-safe.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hyperbit.controller.library import *  # noqa: F403
    from hyperbit.controller.library import __all__ as __all__

    __version__: str


# The names are those of controller/library. It takes two seconds to import, and the command and the daemon, which are
# parts of this package, use none of them.
def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("hyperbit")
    if not name.startswith("__") or name == "__all__":
        library = import_module("hyperbit.controller.library")
        if name == "__all__" or name in library.__all__:
            return getattr(library, name)
    raise AttributeError(f"module 'hyperbit' has no attribute {name!r}")


def __dir__() -> list[str]:
    return ["__version__", *__getattr__("__all__")]
