"""Arms, solvers and solutions as Python objects: pickled, printed, and searched in threads."""

import itertools
import pickle
import subprocess
import sys

import numpy as np
import pytest

import hyperbit as hb

JOINTS = [(0.15, 0, 0), (-0.075, 0.13, 0), (-0.075, -0.13, 0)]
MODULES = {
    "planar": lambda: [
        hb.revolute([-0.3, 0.3], link=(0.0, 0.2)),
        hb.prismatic((0, 1), [0.1, 0.2]),
        hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=2),
    ],
    "spatial": lambda: [
        hb.revolute([-0.3, 0.3], axis=(1, 0, 0), link=(0.0, 0.0, 0.2), count=2),
        hb.platform(JOINTS, JOINTS, (0.18, 0.22)),
        hb.transforms([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])]),
    ],
}
DEADLINE = 30.0  # [s], so that a busy machine proves as much as an idle one


@pytest.fixture(params=MODULES)
def mixed(request: pytest.FixtureRequest) -> hb.Arm:
    return hb.Arm(MODULES[request.param](), name="mixed", pixel=0.05, tolerance=0.02)


def test_arms_and_solvers_are_pickled(mixed: hb.Arm) -> None:
    rows = mixed.sample(5)
    locked = mixed.lock({mixed.actuators[0]: "extended"})
    for arm in (mixed, locked):
        again = pickle.loads(pickle.dumps(arm))
        np.testing.assert_array_equal(again.frames(rows), arm.frames(rows))
        assert again.locked == arm.locked
    solver = hb.Solver(mixed)
    goal = mixed.position(rows[0])
    before = solver.solve(goal, deadline=DEADLINE)
    after = pickle.loads(pickle.dumps(solver)).solve(goal, deadline=DEADLINE)
    assert after.switches == before.switches
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(before)).tip, before.tip)


def test_a_pickled_arm_moves_between_its_states_as_before(mixed: hb.Arm) -> None:
    again = pickle.loads(pickle.dumps(mixed))
    for module, other in zip(mixed._whole.modules, again._whole.modules, strict=True):
        middle = np.full((1, len(module.actuators)), 0.5)
        for one, two in zip(module.between(middle), other.between(middle), strict=True):
            np.testing.assert_allclose(one, two)


def test_arms_and_solvers_print_what_they_are(arm: hb.Arm) -> None:
    assert repr(arm) == "Arm('short': planar, 4 modules, 12 actuators)"
    locked = arm.lock({"2.left": "extended"})
    assert repr(locked) == "Arm('short': planar, 4 modules, 12 actuators, 2.left extended)"
    solver = hb.Solver(arm, obstacles=[hb.Disc((2.0, 2.0), 0.1)])
    assert repr(solver).startswith(f"Solver({arm!r}, Disc(")
    assert repr(arm.density()).startswith("Density(10^3.6 configurations, ")
    assert "object at" not in repr(solver)


def test_notebooks_show_a_picture(mixed: hb.Arm) -> None:
    for shown in (mixed, hb.Solver(mixed)):
        html = shown._repr_html_()
        assert "modules" in html
        assert '<img alt="mixed" src="data:image/png;base64,iVBOR' in html
    assert "_densities" not in vars(mixed), "a picture must not wait for densities"


def test_solutions_have_a_position(mixed: hb.Arm) -> None:
    solution = hb.Solver(mixed).solve(mixed.position(mixed.sample(1)[0]), deadline=DEADLINE)
    assert solution.position.shape == (mixed.dimension,)
    np.testing.assert_allclose(solution.position, mixed.position(solution.configuration), atol=1e-12)


@pytest.mark.parametrize("kind", [hb.Error, *hb.Error.__subclasses__()])
def test_errors_are_value_errors(kind: type[hb.Error]) -> None:
    assert issubclass(kind, ValueError)


def test_many_goals_have_the_solutions_of_each(arm: hb.Arm) -> None:
    goals = [arm.position(row) for row in arm.sample(12, seed=3)]
    start = arm.sample(1, seed=9)[0]
    solver = hb.Solver(arm)
    many = solver.solve_many(goals, start, deadline=DEADLINE)
    for goal, found in zip(goals, many, strict=True):
        alone = hb.Solver(arm).solve(goal, start, deadline=DEADLINE)
        assert (found.switches, found.certificate) == (alone.switches, alone.certificate)
        np.testing.assert_array_equal(found.configuration, alone.configuration)
    assert solver.solve_many([]) == []
    with pytest.raises(hb.GoalError):
        solver.solve_many([(1, 2, 3)])


def test_frames_of_many_configurations_are_those_of_each(mixed: hb.Arm) -> None:
    rows = mixed.sample(200)
    np.testing.assert_allclose(mixed.frames(rows), [mixed.frame(row) for row in rows], atol=1e-12)
    rows[7, 1] = 99
    with pytest.raises(hb.ConfigurationError, match="99"):
        mixed.frames(rows)
    with pytest.raises(hb.ConfigurationError, match="shape"):
        mixed.frames(rows[:, 1:])


def test_batches_have_the_rows_of_each(mixed: hb.Arm) -> None:
    rows, home = mixed.sample(6, seed=2), mixed.home
    for function in (mixed.position, mixed.module_frames, mixed.outlines, mixed.actuator_states):
        np.testing.assert_allclose(function(rows), [function(row) for row in rows], atol=1e-12)
        np.testing.assert_allclose(function([mixed.format(row) for row in rows]), function(rows))
        assert function(mixed.sample(0)).shape == (0, *function(home).shape)
    each = [mixed.switches(home, row) for row in rows]
    assert mixed.switches(home, rows).tolist() == mixed.switches(rows, home).tolist() == each
    assert mixed.switches(rows, rows).tolist() == [0] * 6
    with pytest.raises(hb.ConfigurationError, match="6 configurations are needed, got 5"):
        mixed.switches(rows, rows[1:])
    with pytest.raises(hb.ConfigurationError, match="configuration: one of shape"):
        mixed.format(rows)


def test_frames_and_outlines_lead_from_the_base_to_the_tip(mixed: hb.Arm) -> None:
    for row in mixed.sample(3):
        frames, lines, modules = mixed.module_frames(row), mixed.outlines(row), mixed.outline_modules
        assert frames.shape == (len(mixed.states) + 1, 4, 4)
        assert lines.shape == (len(modules), 2, mixed.dimension)
        np.testing.assert_allclose(frames[-1], mixed.frame(row), atol=1e-12)
        for k in range(len(mixed.states)):
            own = lines[modules == k].reshape(-1, mixed.dimension)
            low, high, end = own.min(axis=0), own.max(axis=0), frames[k + 1, : mixed.dimension, 3]
            assert ((end >= low - 1e-9) & (end <= high + 1e-9)).all(), "the next frame is within the module's lines"


def test_the_library_imports_no_plotting_and_no_statistics() -> None:
    code = "import sys, hyperbit; hyperbit.Solver; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert not {"matplotlib", "scipy.spatial", "scipy.optimize"} & set(done.stdout.split())


def test_a_truss_on_a_joint_is_drawn_without_a_gap() -> None:
    truss, joint = (hb.vgt("AD", width=0.2, lengths=(0.2, 0.25), count=2), hb.revolute([-0.3, 0.3], link=(0.0, 0.2)))
    arm = hb.Arm([truss, joint, truss, hb.prismatic((0, 1), [0.1, 0.2]), truss])
    whole = arm._whole
    for row in arm.sample(4):
        counts = [module.body.shape[1] for module in whole.modules]
        bodies = np.split(whole.body(row), np.cumsum(counts)[:-1])
        for below, above in itertools.pairwise(bodies):
            ends = [distance(point, below) for point in above.reshape(-1, 3)]
            ends += [distance(point, above) for point in below.reshape(-1, 3)]
            assert min(ends) < 1e-9
        assert counts == [4, 4, 1, 5, 4, 1, 5, 4], "only a truss on a joint has a bar of its own"


def distance(point: np.ndarray, lines: np.ndarray) -> float:
    """Least distance of a point from line segments (n, 2, 3)."""
    first, along = lines[:, 0], lines[:, 1] - lines[:, 0]
    lengths = np.maximum((along**2).sum(axis=1), 1e-30)
    shares = np.clip(((point - first) * along).sum(axis=1) / lengths, 0, 1)
    return float(np.linalg.norm(first + shares[:, None] * along - point, axis=1).min())


def test_goals_are_read_from_the_files_of_send(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,th,t\n1,2,,0\n1,3,0.5,1\n")
    (tmp_path / "a.yaml").write_text(
        "tolerance: {position: 0.1}\nwaypoints: [{position: [1, 2]}, {position: [1, 3], orientation: 0.5}]\n"
    )
    (tmp_path / "b.yaml").write_text('waypoints: [{configuration: "00"}]\n')
    for name, tolerance in (("a.csv", None), ("a.yaml", 0.1)):
        first, second = hb.read_goals(tmp_path / name)
        assert (first.position.tolist(), first.orientation, second.orientation) == ([1.0, 2.0], None, 0.5)
        assert second.tolerance == tolerance
    for name, told in (("b.yaml", "waypoint 1: a configuration"), ("none.csv", "none.csv: cannot be read: No such")):
        with pytest.raises(hb.GoalError, match=told):
            hb.read_goals(tmp_path / name)
