"""Odd values at each argument of the library end in a result, or in an error of the library that names the argument."""

import inspect
import pickle
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hyperbit as hb

DEPLOY = Path(__file__).parents[2] / "deploy"
PAIR = [(0, 0), (1, 0), (0.5, 0)]


class Evil:
    """An object whose own conversions fail."""

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise KeyError("no array")

    def __repr__(self) -> str:
        raise RuntimeError("no text")


ODD: tuple[Callable[[], Any], ...] = (
    lambda: None,
    lambda: True,
    lambda: -1,
    lambda: 0,
    lambda: 3,
    lambda: 10**400,
    lambda: 10**5000,
    lambda: 2.5,
    lambda: float("nan"),
    lambda: float("inf"),
    lambda: 1e308,
    lambda: 1 + 2j,
    lambda: "",
    lambda: "odd",
    lambda: "9" * 5000,
    lambda: "\ud800",
    lambda: "a\0b",
    lambda: b"odd",
    lambda: [],
    lambda: {},
    lambda: {1: 2},
    lambda: {"1.left": [np.zeros(2)]},
    lambda: {0.1},
    lambda: object(),
    lambda: Evil(),
    lambda: [Evil()],
    lambda: (k for k in range(3)),
    lambda: range(3),
    lambda: abs,
    lambda: int,
    lambda: np.float32("nan"),
    lambda: np.datetime64("2020-01-01"),
    lambda: np.array(["a", 1], dtype=object),
    lambda: np.array([None, 1.0]),
    lambda: np.zeros((2, 3, 4)),
    lambda: np.zeros((0, 2)),
    lambda: np.full((2, 2), np.nan),
    lambda: np.ma.masked_array([0.1, 0.2], [True, False]),
    lambda: [[1], [2, 3]],
    lambda: ["a", 1],
    lambda: [None],
    lambda: (1e308, -1e308),
    lambda: (0.1, 0.8),
    lambda: [(0.1, 0.8)],
    lambda: [1, 2, 3],
    lambda: np.array([2**63 + 1] * 4, dtype=np.uint64),
    lambda: [-1, 0, 0, 0],
    lambda: Path("missing"),
    lambda: hb.Disc((9, 9), 0.1),
    lambda: [hb.Sphere((9, 9, 9), 0.1)],
    lambda: hb.Goal((0.1, 0.8, 0.2)),
)
COSTLY = ("workers", "evaluations")  # these values start processes and long searches
odd_values = st.sampled_from(ODD) | (st.floats() | st.integers() | st.text(max_size=3) | st.binary()).map(
    lambda it: lambda: it
)


def calls(arm: hb.Arm, folder: Path) -> dict[Callable[..., Any], dict[str, Any]]:
    """Returns each public function and method with arguments that are right."""
    solver, home, module = hb.Solver(arm), "0000", hb.vgt(width=0.2, lengths=(0.2, 0.25))
    effort = {"effort": 1, "missed": 1}
    study = hb.Study(
        lambda width: hb.Arm([hb.vgt(width=width, lengths=(0.2, 0.25))]), {"width": {"between": [0.1, 0.2]}}, [(0, 0.2)]
    )
    picture = {"obstacles": (), "targets": (), "title": None, "unit": None, "density": False, "ax": None}
    animation = hb.animate(arm, [home, "0001"], density=False)
    return {
        hb.load: {"path": DEPLOY / "planar16.yaml"},
        hb.read_goals: {"file": folder / "goals.csv"},
        hb.vgt: {"first_diagonal": "BC", "width": 0.2, "lengths": (0.2, 0.25), "count": 1},
        hb.revolute: {"angles": [0, 1], "cylinders": None, "link": (0, 1), "axis": (0, 0, 1), "count": 1},
        hb.prismatic: {"axis": (0, 1), "lengths": [0, 1], "cylinders": None, "link": (0, 1), "count": 1},
        hb.platform: {"base": PAIR, "top": PAIR, "lengths": (1.0, 1.2), "count": 1},
        hb.transforms: {"states": [np.eye(4)] * 2, "count": 1},
        hb.group: {"modules": [module], "count": 1},
        hb.Arm: {
            "modules": [module],
            "name": "arm",
            "unit": None,
            "base": None,
            "tip": None,
            "tolerance": 0.1,
            "angle_tolerance": 0.1,
            "obstacles": (),
            "body_radius": 0,
            "self_collision": False,
            "pixel": None,
        },
        arm.lock: {"states": {"1.left": "extended"}},
        arm.save: {"path": folder / "arm.yaml"},
        arm.frame: {"configuration": home},
        arm.frames: {"configurations": [home]},
        arm.module_frames: {"configuration": home},
        arm.outlines: {"configuration": home},
        arm.position: {"configuration": home},
        arm.actuator_states: {"configuration": home},
        arm.configuration: {"actuator_states": [0] * 12},
        arm.parse: {"configuration": home},
        arm.format: {"configuration": home},
        arm.switches: {"first": home, "second": home},
        arm.sample: {"count": 2, "seed": 0},
        arm.reach: {"radius": 0.1},
        arm.coverage: {"radius": 0.1, "seed": 0},
        arm.orientations: {"point": (0.0, 0.8), "radius": 0.1, "seed": 0},
        arm.locked_reach: {"locks": 1, "samples": 1, "seed": 0},
        arm.density().at: {"points": (0.0, 0.8)},
        hb.Goal: {"position": (0, 1), "orientation": 0.1, "tolerance": 0.1, "angle_tolerance": 0.1},
        hb.Disc: {"centre": (9, 9), "radius": 0.1, "name": None},
        hb.Sphere: {"centre": (9, 9, 9), "radius": 0.1, "name": None},
        hb.Box: {"centre": (9, 9), "size": (1, 1), "angle": None, "orientation": None, "name": None},
        hb.HalfPlane: {"point": (9, 9), "normal": (0, -1), "name": None},
        hb.HalfSpace: {"point": (9, 9, 9), "normal": (0, -1, 0), "name": None},
        hb.Solver: {"arm": arm, "obstacles": (), "weights": None, "list_whole": True},
        solver.solve: {"goal": (0.0, 0.8), "start": None, "method": "minimum-switch", "deadline": 0.01, **effort},
        solver.solve_many: {
            "goals": [(0.0, 0.8)],
            "start": None,
            "method": "minimum-switch",
            "deadline": 0.01,
            **effort,
        },
        solver.follow: {
            "goals": [(0.0, 0.8)],
            "start": None,
            "path_tolerance": None,
            "method": "minimum-switch",
            "deadline": 0.01,
            "prove": False,
        },
        solver.contact: {"configuration": home},
        drained: {
            "solver": solver,
            "goals": [(0.0, 0.8)],
            "start": None,
            "client": None,
            "workers": 1,
            "effort": 1,
            "method": "minimum-switch",
        },
        hb.plot: {"arm": arm, "drawn": home, **picture},
        hb.animate: {"arm": arm, "motion": home, **picture},
        animation.save: {"filename": folder / "arm.gif"},
        hb.calibrate: {
            "arm": arm,
            "configurations": arm.sample(12),
            "tips": arm.position(arm.sample(12)),
            "each": False,
            "fit": (),
        },
        hb.merit: {
            "arm": arm,
            "targets": [(0.0, 0.8)],
            "obstacles": (),
            "weights": None,
            "effort": 1,
            "missed": 1,
            "stuck": False,
        },
        hb.Study: {
            "build": lambda width: arm,
            "parameters": {"width": {"between": [0.1, 0.2]}},
            "targets": [(0.0, 0.8)],
            "name": "study",
            "seed": 1,
            "evaluations": 1,
            "effort": {},
            "finalists": {},
            "require": {},
            "objectives": ["reached", "switches"],
        },
        hb.design: {"study": study, "evaluations": 1, "seed": 1, "output": None, "workers": 1, "client": None},
    }


def drained(**arguments: Any) -> list[hb.Solution]:
    """Returns all solutions of hb.map."""
    return list(hb.map(**arguments))


@pytest.fixture(scope="module")
def right(arm: hb.Arm, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Callable[..., Any], dict[str, Any]]]:
    folder = tmp_path_factory.mktemp("files")
    (folder / "goals.csv").write_text("x,y\n1,2\n")
    return list(calls(arm, folder).items())


@settings(deadline=None, max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), odd=odd_values)
def test_odd_values_end_in_a_result_or_in_a_named_error(right, tmp_path, monkeypatch, data, odd) -> None:
    monkeypatch.chdir(tmp_path)  # a text may be the name of a file
    call, arguments = data.draw(st.sampled_from(right))
    name = data.draw(st.sampled_from([name for name in arguments if name not in COSTLY]))
    value, message = odd(), name
    try:
        call(**{**arguments, name: value})
    except hb.Error as error:
        message = str(error)
    file = value if isinstance(value, str | Path) else name
    assert any(word in message for word in (*arguments, "configuration", "position", str(file))), f"{name}: {message}"


def test_each_public_call_is_tried(right) -> None:
    tried = {getattr(call, "__qualname__", "") for call, _ in right} | {"map"}
    for name in hb.__all__:
        public = getattr(hb, name)
        assert not inspect.isfunction(public) or name in tried
    for kind in (hb.Arm, hb.Solver, hb.Density):
        for base in kind.__mro__[:-1]:
            methods = [name for name, it in vars(base).items() if inspect.isfunction(it) and not name.startswith("_")]
            assert {f"{base.__name__}.{name}" for name in methods} - {"Arm.density"} <= tried


def test_two_threads_in_one_solver_are_refused_and_it_stays_usable(arm: hb.Arm) -> None:
    solver, entered, leave = hb.Solver(arm), threading.Event(), threading.Event()

    class Goals(list[Any]):
        """Goals that keep a thread in the solver until it may leave."""

        checked = False

        def __iter__(self) -> Any:
            if self.checked:
                entered.set()
                leave.wait(60)
            self.checked = True
            return super().__iter__()

    found = list[hb.Solution]()
    other = threading.Thread(target=lambda: found.extend(solver.solve_many(Goals([(0.0, 0.8)]))))
    other.start()
    assert entered.wait(60)
    refused = list[str]()
    for act in (
        lambda: solver.solve((0.0, 0.8)),
        lambda: solver.solve_many([(0.0, 0.8)]),
        lambda: solver.follow([(0.0, 0.8)]),
        lambda: solver.contact("0000"),
    ):
        try:
            act()
        except hb.ThreadError as error:
            refused.append(str(error))
    leave.set()
    other.join(60)
    assert refused == ["another thread uses this solver: make a solver for each thread, or call solve_many"] * 4
    assert solver.solve((0.0, 0.8)).within_tolerance == found[0].within_tolerance
    assert pickle.loads(pickle.dumps(solver)).contact("0000") is None
