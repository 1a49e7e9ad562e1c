"""Commands that share work print the same bytes from one process and from two workers."""

from __future__ import annotations

import numpy as np
import pytest

from hyperbit.controller.manipulator.notation import format_configuration
from tests.calibration.making import TRUSSES, arm_of, erring, measured

LONG = """
name: long
modules: [{type: vgt, count: 14, width: 0.2, lengths: [0.2, 0.25]}]
tolerance: {position: 0.01}
workspace: {memory: 4}
"""
TWO = ("--workers", "2")


@pytest.fixture
def samples(tmp_path):
    """Arguments of `calibrate`: an arm's file, and measured tips of an arm with errors."""
    arm, rng = arm_of(tmp_path, TRUSSES), np.random.default_rng(3)
    found = measured(arm, erring(arm, rng, each=True), rng, 60)
    rows = [
        f"{format_configuration(arm.manipulator, configuration)},{float(tip[0, 3])!r},{float(tip[1, 3])!r}\n"
        for configuration, tip in zip(found.configurations, found.tips, strict=True)
    ]
    file = tmp_path / "samples.csv"
    file.write_text("configuration,x,y\n" + "".join(rows))
    return str(tmp_path / "arm.yaml"), str(file)


@pytest.mark.usefixtures("own_folders")
def test_workspace_prints_the_same_figures(hyperbit, tmp_path):
    file = tmp_path / "arm.yaml"
    file.write_text(LONG)
    words = "workspace", str(file), "--locked", "2", "--samples", "20", "--picture", str(tmp_path / "p.png"), "--json"
    code, alone, _ = hyperbit(*words)
    assert code == 0
    assert '"draws"' in alone
    assert hyperbit(*words, *TWO)[:2] == (0, alone)


@pytest.mark.usefixtures("own_folders")
def test_calibrate_prints_the_same_numbers(hyperbit, samples):
    words = "calibrate", *samples, "--each", "--json"
    alone = hyperbit(*words)
    assert alone[0] in (0, 1)
    assert alone[1]
    assert hyperbit(*words, *TWO)[:2] == alone[:2]


def test_both_options_contradict_each_other(hyperbit, samples):
    code, _, err = hyperbit("calibrate", *samples, *TWO, "--dask", "tcp://127.0.0.1:1")
    assert code == 2
    assert "the cluster has its own workers: leave out --workers" in err
