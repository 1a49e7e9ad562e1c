"""Calibration recovers known errors from noisy tips, as far as the samples determine them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from hyperbit.controller.calibration import calibration
from hyperbit.controller.calibration.calibration import FOLDS, calibrated, folds
from hyperbit.controller.calibration.fit import CannotFit
from hyperbit.controller.calibration.model import Model
from hyperbit.controller.calibration.parameters import described, parameters, value_at
from hyperbit.controller.manipulator import frames
from tests.calibration.making import ARMS, NOISE, TRUSSES, TURN, arm_of, erring, measured

KINDS = pytest.mark.parametrize("kind", ARMS)
ORIENTED = [(kind, True) for kind in ARMS] + [("joints", False), ("frames", False)]  # one in the plane, one in space
THREE = [{**TRUSSES[0], "count": 3}]
pytestmark = pytest.mark.timeout(900)  # a calibration is twelve fits: seconds alone, minutes beside other programs


@pytest.fixture
def two_folds(monkeypatch):
    """Six fits instead of twelve, for tests of other figures than the cross-validated ones."""
    monkeypatch.setattr(calibration, "FOLDS", 2)


@KINDS
def test_residuals_follow_each_parameter_as_reckoned(tmp_path, kind):
    arm, rng = arm_of(tmp_path, ARMS[kind]), np.random.default_rng(5)
    samples = measured(arm, erring(arm, rng), rng, 9)
    description = described(arm, each=False)
    model = Model(description, parameters(description, arm.manipulator.length, len(arm.manipulator.modules)))
    steps, h = rng.normal(size=len(model.parameters)) * 1e-3, 1e-6
    reckoned = model.jacobian(samples, steps)
    for p, unit in enumerate(np.eye(len(steps)) * h):
        slope = (model.residuals(samples, steps + unit) - model.residuals(samples, steps - unit)) / (2 * h)
        assert_allclose(reckoned[:, :, p], slope, atol=1e-5, err_msg=model.parameters[p].path)


@pytest.mark.parametrize(("kind", "oriented"), ORIENTED)
@pytest.mark.usefixtures("two_folds")
def test_tips_of_the_real_arm_are_met_as_well_as_they_were_measured(tmp_path, kind, oriented):
    arm, rng = arm_of(tmp_path, ARMS[kind]), np.random.default_rng(1)
    real = erring(arm, rng)
    found = calibrated(arm, measured(arm, real, rng, 120, oriented=oriented), each=False)
    unseen = measured(arm, real, rng, 200, noise=0.0)
    model = Model(found.description, [])
    off = np.linalg.norm((model.tips(unseen, np.zeros(0)) - unseen.tips)[:, :3, 3], axis=1)
    assert found.outliers == ()
    assert found.noise[0] == pytest.approx(NOISE, rel=0.2)
    if oriented:
        assert found.noise[1] == pytest.approx(TURN, rel=0.2)
    assert np.sqrt((off**2).mean()) < NOISE  # 120 samples determine a tip better than one does
    assert found.before.position.rms > 20 * NOISE
    assert found.held_out.position.rms < 2.5 * NOISE
    assert found.better


@pytest.mark.usefixtures("two_folds")
def test_parameters_are_as_near_as_their_deviations_say(tmp_path):
    arm, off = arm_of(tmp_path, TRUSSES), []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        real = erring(arm, rng)
        for change in calibrated(arm, measured(arm, real, rng, 60), each=False).changes:
            off.append((change.after - value_at(real.description, change.parameter.where)) / change.deviation)
            assert change.determined
    assert 0.6 < np.sqrt(np.square(off).mean()) < 1.5


@pytest.mark.usefixtures("two_folds")
def test_every_module_by_itself(tmp_path):
    arm, rng = arm_of(tmp_path, THREE), np.random.default_rng(2)
    samples = measured(arm, erring(arm, rng, each=True), rng, 60)
    shared, each = (calibrated(arm, samples, each=chosen) for chosen in (False, True))
    assert [entry["first_diagonal"] for entry in each.description["modules"]] == ["BC", "AD", "BC"]
    assert shared.held_out.position.rms > 5 * NOISE
    assert each.held_out.position.rms < 2 * NOISE
    assert each.noise[0] == pytest.approx(NOISE, rel=0.2)


@pytest.mark.usefixtures("two_folds")
def test_samples_far_off_are_set_aside_and_change_nothing(tmp_path):
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(3)
    samples = measured(arm, erring(arm, rng), rng, 100)
    clean = calibrated(arm, samples.only(np.arange(100) >= 20), each=False)
    samples.tips[:12, :2, 3] += rng.normal(size=(12, 2))
    samples.tips[12:20] = samples.tips[12:20] @ frames.turned([0, 0, 1], np.pi)
    found = calibrated(arm, samples, each=False)
    assert found.outliers == tuple(range(2, 22))
    assert_allclose(found.after.position.rms, clean.after.position.rms, rtol=1e-3)


def test_the_world_of_a_tracker_may_be_any(tmp_path):
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(4)
    samples = measured(arm, erring(arm, rng), rng, 60)
    away = frames.planar(20, -30, 3.1)
    found = calibrated(arm, replace(samples, tips=away @ samples.tips), each=False)
    assert found.outliers == ()
    assert found.held_out.position.rms < 2.5 * NOISE


@pytest.mark.usefixtures("two_folds")
def test_what_samples_do_not_determine_stays(tmp_path):
    """A joint that turns and a link that turns back: the tips are the same."""
    arm, rng = arm_of(tmp_path, ARMS["joints"]), np.random.default_rng(6)
    samples = measured(arm, erring(arm, rng), rng, 80)
    samples.configurations[:, 4] = 1  # the slide is never at its first stop
    found = calibrated(arm, replace(samples, tips=arm.manipulator.tips(samples.configurations)), each=False)
    unseen = {change.parameter.path: change for change in found.changes}["modules[1].lengths[0]"]
    assert not unseen.determined
    assert unseen.after == 0.1
    assert found.undetermined >= 3
    changes = [np.subtract(change.after, change.before) for change in found.changes]
    assert np.abs(np.hstack(changes)).max() < 1e-6  # these tips are those of the file's arm


def test_an_arm_as_in_its_file_is_not_called_better(tmp_path):
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(7)
    found = calibrated(arm, measured(arm, erring(arm, rng, size=0.0, base=0.0), rng, 40), each=False)
    assert not found.better
    assert found.before.position.rms == pytest.approx(NOISE * np.sqrt(2), rel=0.3)


@pytest.mark.parametrize(
    ("count", "each", "message"),
    [
        (9, False, "9 samples, at least 10 are needed"),
        (20, True, "20 samples of 3 values each are too few for the 38 numbers that they depend on: .*; at least 33 "),
    ],
)
def test_too_few_samples(tmp_path, count, each, message):
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(8)
    with pytest.raises(CannotFit, match=message):
        calibrated(arm, measured(arm, erring(arm, rng), rng, count), each=each)


@pytest.mark.parametrize(
    ("name", "each", "oriented"), [("trusses", True, False), ("joints", False, False), ("series", True, True)]
)
def test_the_number_that_is_asked_for_suffices(tmp_path, name, each, oriented):
    arm, rng = arm_of(tmp_path, ARMS[name]), np.random.default_rng(3)
    real = erring(arm, rng, each=each)
    with pytest.raises(CannotFit) as caught:
        calibrated(arm, measured(arm, real, rng, 10, oriented=oriented), each=each)
    asked = int(re.search(r"at least (\d+) samples", str(caught.value))[1])
    assert len(calibrated(arm, measured(arm, real, rng, asked, oriented=oriented), each=each).changes) > 0


@pytest.mark.usefixtures("two_folds")
def test_samples_of_another_arm_suit_none(tmp_path):
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(9)
    samples = measured(arm, erring(arm, rng), rng, 60)
    samples.configurations[:] = rng.permutation(samples.configurations)
    try:
        assert not calibrated(arm, samples, each=False).held_out.position.rms < 100 * NOISE
    except CannotFit as error:
        assert "outliers" in str(error)  # noqa: PT017


def test_a_new_base_alone_is_not_called_better(tmp_path):
    """A tracker in another frame: with a fitted base, the file's modules predict its tips as well as any."""
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(7)
    samples = measured(arm, erring(arm, rng, size=0.0, base=0.0), rng, 60)
    found = calibrated(arm, replace(samples, tips=frames.planar(20, -30, 1.0) @ samples.tips), each=False)
    assert found.before.position.rms > 10
    assert found.base_only.position.rms == pytest.approx(NOISE * np.sqrt(2), rel=0.3)
    assert not found.better


def test_modules_that_err_are_called_better_than_a_new_base(tmp_path):
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(1)
    found = calibrated(arm, measured(arm, erring(arm, rng), rng, 100), each=False)
    assert found.held_out.position.rms < 0.5 * found.held_out_base_only.position.rms
    assert found.better


def test_folds_keep_measurements_of_one_configuration_together():
    rows = np.random.default_rng(0).integers(0, 3, (40, 4))
    order = np.random.default_rng(1).permutation(np.repeat(np.arange(40), 5))
    fold = folds(rows[order])
    assert set(fold.tolist()) == set(range(FOLDS))
    for row in np.unique(rows, axis=0):
        assert len(set(fold[(rows[order] == row).all(axis=1)].tolist())) == 1
    assert np.bincount(fold).min() > 0.5 * len(fold) / FOLDS


def test_no_fold_learns_from_the_samples_it_is_judged_by(tmp_path, monkeypatch):
    """Neither the start nor the base nor the outliers of a fold's fit may depend on the fold."""
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(2)
    samples = measured(arm, erring(arm, rng), rng, 60)
    asked, real = [], calibration.fit

    def watched(model, own, length, *others):
        asked.append((len(own.tips), model.description["base"]))
        assert not others
        return real(model, own, length)

    monkeypatch.setattr(calibration, "fit", watched)
    calibrated(arm, samples, each=False)
    fold = folds(samples.configurations)
    sizes = [int((fold != k).sum()) for k in range(FOLDS)]
    assert [count for count, _ in asked] == [60, 60] + [size for size in sizes for _ in range(2)]
    for k, (_, base) in enumerate(asked[2::2]):
        assert base == calibration.base_under(arm, samples.only(fold != k))


def test_too_few_configurations(tmp_path):
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(8)
    samples = measured(arm, erring(arm, rng), rng, 40)
    samples.configurations[:] = samples.configurations[np.arange(40) % 4]
    with pytest.raises(CannotFit, match="4 different configurations, at least 5 are needed"):
        calibrated(arm, samples, each=False)
