"""A user's program with each public name. `make check` runs mypy --strict on it; no test runs it."""

from collections.abc import Iterator

import numpy as np

import hyperbit as hb

method: hb.Method = hb.METHODS[0]
modules: list[hb.Module] = [
    hb.vgt(width=0.2, lengths=(0.2, 0.25), count=2),
    hb.revolute([-0.3, 0.3], link=np.eye(4)),
    hb.prismatic((0, 1), [0.0, 0.1]),
    hb.platform([(0, 0), (1, 0), (0.5, 0)], [(0, 0), (1, 0), (0.5, 0)], (1.0, 1.2)),
    hb.transforms([np.eye(4), np.eye(4)]),
    hb.group([hb.vgt(width=0.2, lengths=(0.2, 0.25))], 2),
]
shapes: list[hb.Obstacle] = [
    hb.Disc(np.array([1.0, 2.0]), np.float32(0.3), name="pillar"),
    hb.Sphere((1, 2, 3), 0.3),
    hb.Box((1, 2), (0.1, 0.2), angle=0.3),
    hb.HalfPlane((0, 0), (0, 1)),
    hb.HalfSpace((0, 0, 0), (0, 0, 1)),
]
arm: hb.Arm = hb.Arm(modules, tolerance=np.float64(0.002), obstacles=shapes[:1])
loaded: hb.Arm = hb.load("arm.yaml")
states: dict[str, str] = {"1.left": "extended"}
locked = arm.lock(states)
version: str = hb.__version__


def solve(points: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> Iterator[hb.Solution]:
    ik = hb.Solver(locked, weights=np.ones(12))
    goal = hb.Goal((np.float32(0.5), 2.9), orientation=np.float32(0.1), tolerance=np.float64(0.01))
    found: hb.Solution = ik.solve(goal, start=arm.home, method=method, effort=np.int64(20))
    certificate: hb.Certificate = found.certificate
    many: list[hb.Solution] = ik.solve_many([*points, *hb.read_goals("goals.csv")], start=found)
    path: hb.Path = ik.follow(points, path_tolerance=np.float32(0.1))
    figure = hb.plot(arm, path, title=certificate)
    hb.plot(arm, {"home": arm.home, "first": found}, ax=figure.add_subplot()).savefig("path.png")
    hb.animate(arm, [arm.home, *path.solutions]).save("path.gif")
    density: hb.Density = arm.density()
    reach: hb.Reach = arm.reach(np.float32(0.01))
    print(reach.extent, arm.position(path.configurations), arm.outlines("0" * 8)[arm.outline_modules == 0])
    fitted: hb.Fitted = hb.calibrate(arm, path.configurations, path.positions)
    worth: hb.Merit = hb.merit(arm, points, weights=np.ones(len(points)), effort=np.int64(10))
    study = hb.Study(lambda width: hb.Arm([hb.vgt(width=width, lengths=(0.2, 0.25))]), {}, points, seed=1)
    designs: hb.Designs = hb.design(study, 10, output="designs.jsonl", workers=2)
    best: hb.Design = designs.front[0]
    print(worth.reached, designs.table(), best.final, designs.save("arms"), designs.plot())
    print(len(many), density.total, fitted.arm.name, version)
    yield from hb.map(ik, points, workers=2)


try:
    arm.configuration([0, 1])
except hb.ArmError as wrong:
    print(wrong.faults, wrong.lines)
except (hb.CalibrationError, hb.ConfigurationError, hb.GoalError, hb.LockError, hb.PictureError) as error:
    print(error)
except (hb.ObstacleError, hb.PathError, hb.StudyError, hb.ThreadError, hb.Error) as error:
    print(error)
