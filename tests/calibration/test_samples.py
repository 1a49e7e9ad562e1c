"""Files of measured tips: round trip, and faults with their lines."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from hyperbit.controller.arm.tables import PLANAR, SPATIAL
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.calibration.samples import read_samples
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.notation import format_configuration
from tests.arms import paper_arm, spatial_arm

SEEDS = st.integers(0, 2**32 - 1)


def written(manipulator, configurations, tips, columns) -> str:
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(columns)
    for configuration, tip in zip(configurations, tips, strict=True):
        spelled = "".join(map(str, manipulator.actuator_states(configuration)))
        values = {"configuration": format_configuration(manipulator, configuration), "actuators": spelled}
        values |= dict(zip(("x", "y", "z"), tip[:3, 3], strict=True)) | {"th": frames.angle(tip)}
        values |= dict(zip(SPATIAL[3:], frames.quaternion(tip), strict=True))
        writer.writerow([values[column] for column in columns])
    return text.getvalue()


@given(st.booleans(), st.booleans(), st.sampled_from(["configuration", "actuators"]), SEEDS)
def test_samples_read_back(tmp_path_factory, planar, oriented, state, seed):
    rng = np.random.default_rng(seed)
    manipulator = paper_arm(3) if planar else spatial_arm(3)
    configurations = rng.integers(0, 6, (7, 3))
    tips = manipulator.tips(configurations)
    columns = [state, *(PLANAR if planar else SPATIAL)[: None if oriented else manipulator.dimension]]
    rng.shuffle(columns)
    file = Path(tmp_path_factory.getbasetemp(), "samples.csv")
    file.write_text(written(manipulator, configurations, tips, columns))
    found = read_samples(file, manipulator)
    assert found.oriented is oriented
    assert_array_equal(found.configurations, configurations)
    assert_array_equal(found.lines, np.arange(2, 9))
    assert_allclose(found.tips[:, :3, 3], tips[:, :3, 3], atol=1e-12)
    assert_allclose(found.tips[:, :3, :3], tips[:, :3, :3] if oriented else [np.eye(3)] * 7, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "columns configuration or actuators, and x,y or x,y,th, are needed for this arm, got none"),
        ("x,y\n1,2\n", "columns configuration or actuators, and x,y or x,y,th, are needed for this arm, got x,y"),
        ("configuration,actuators,x,y\n", "got configuration,actuators,x,y"),
        ("configuration,x,y,z\n", "got configuration,x,y,z"),
        ("configuration,x,x,y\n", "column 'x' occurs twice"),
        ("configuration,x,y\n", "no samples"),
        ("configuration,x,y\n17,1\n", "line 2: y: a number is needed, got ''"),
        (
            "configuration,x,y\n1,7,1,2\n",
            "line 2: 3 fields are needed, got 4; a number has a decimal point, such as 0.3",
        ),
        ("configuration,x,y\n178,1,2\n", "line 2: configuration: configuration '178' has 3 modules, the arm has 2"),
        ("configuration,x,y\n18,1,2\n", "line 2: configuration: configuration '18': module 2 has states 0 to 7"),
        ("configuration,x,y\n17,1,2\n17,nan,2\n", "line 3: x: a number is needed, got 'nan'"),
        ("configuration,x,y,th\n17,1,2,90\n", "line 2: th: a number from -12.5664 to 12.5664 is needed, got '90'"),
        ("actuators,x,y\n01201,1,2\n", "line 2: actuators: a 0 or 1 for each actuator is needed, got '01201'"),
        ("actuators,x,y\n01,1,2\n", "line 2: actuators: the arm has 6 actuator states, got an array of shape (2,)"),
        ("configuration,x,y\n\x00,1,2\n", "line 2: configuration: configuration '\\x00'"),
        ('configuration,x,y\n"17,1,2\n', "cannot be read: unexpected end of data"),
    ],
)
def test_faults(tmp_path, text, fault):
    file = tmp_path / "samples.csv"
    file.write_text(text)
    with pytest.raises(InputFaults) as raised:
        read_samples(file, paper_arm(2))
    assert fault in str(raised.value)


@pytest.mark.parametrize(
    ("row", "fault"), [("00,1,2,3,0,0,0,0.9", "length 1 is needed"), ("00,1,2,3,0,0,0,one", "qw: a number is needed")]
)
def test_faults_of_spatial_samples(tmp_path, row, fault):
    file = tmp_path / "samples.csv"
    file.write_text(f"configuration,{','.join(SPATIAL)}\n{row}\n")
    with pytest.raises(InputFaults, match=fault):
        read_samples(file, spatial_arm(2))


@given(st.binary(max_size=200))
def test_nonsense_is_refused_in_words(tmp_path_factory, content):
    file = Path(tmp_path_factory.getbasetemp(), "nonsense.csv")
    file.write_bytes(b"configuration,x,y\n" + content)
    try:
        found = read_samples(file, paper_arm(2))
    except InputFaults:
        return
    assert np.isfinite(found.tips).all()


def test_a_missing_file(tmp_path):
    with pytest.raises(InputFaults, match="cannot be read: No such file"):
        read_samples(tmp_path / "none.csv", paper_arm(2))


def test_more_samples_than_are_taken(tmp_path):
    file = tmp_path / "samples.csv"
    file.write_text("configuration,x,y\n" + "17,1,2\n" * 5001)
    with pytest.raises(InputFaults, match="more than 5000 samples"):
        read_samples(file, paper_arm(2))
