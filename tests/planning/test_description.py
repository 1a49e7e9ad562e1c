"""The payload of `arm`, and its optional parts."""

import base64
import hashlib
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.arm.description import density, drawing, file
from hyperbit.controller.messages.arm import ArmFile
from hyperbit.controller.workspace.mapping import map_densities
from tests.keys import DEPLOY


def test_the_drawing_is_that_of_the_arm() -> None:
    m = load(DEPLOY / "planar16.yaml").manipulator
    told = drawing(load(DEPLOY / "planar16.yaml"))
    configuration = np.arange(16) % 8
    kinds = [told.kinds[k] for k in told.modules]
    states = np.concatenate([kind.bits[state] for kind, state in zip(kinds, configuration, strict=True)])
    np.testing.assert_array_equal(states, m.actuator_states(configuration))
    chain = m.chain(configuration)
    body = [
        np.array(kind.body[state]) @ frame[:3, :3].T + frame[:3, 3]
        for kind, state, frame in zip(kinds, configuration, chain[:-1], strict=True)
    ]
    np.testing.assert_allclose(np.concatenate(body), m.body(configuration))


def test_modules_of_one_kind_are_told_once() -> None:
    assert len(drawing(load(DEPLOY / "planar16.yaml")).kinds) <= 2
    assert len(drawing(load(DEPLOY / "platform8.yaml")).kinds) == 1


def test_the_density_is_told_pixel_by_pixel() -> None:
    arm = load(DEPLOY / "planar16.yaml")
    densities = map_densities(arm.manipulator, arm.manipulator.length / 50, 10_000)
    told = density(densities, planar=True)
    shades = np.frombuffer(zlib.decompress(base64.b64decode(told.values)), np.uint8).reshape(told.shape)
    assert shades.shape == densities.level(0).shape
    np.testing.assert_array_equal(shades > 0, densities.level(0) >= 0)
    assert shades.max() == 255
    assert told.greatest == pytest.approx(densities.level(0).max() - np.log(densities.volume(0, planar=True)))


def test_the_file_is_told_with_its_tables(tmp_path: Path) -> None:
    (tmp_path / "bend.csv").write_text("x,y,th\n0,1,0\n0,1,0.3\n")
    modules = [{"type": "transforms", "table": "bend.csv", "count": 2}]
    text = yaml.safe_dump({"name": "measured", "modules": modules, "tolerance": {"position": 0.01}})
    path = tmp_path / "measured.yaml"
    path.write_text(text)
    told = file(load(path))
    tables = {"bend.csv": "x,y,th\n0,1,0\n0,1,0.3\n"}
    assert told == ArmFile("measured.yaml", text, hashlib.sha256(text.encode()).hexdigest(), tables)
    path.unlink()
    assert file(load_again(text, path)) is None


def load_again(text: str, path: Path) -> Arm:
    """An arm whose file was deleted."""
    path.write_text(text)
    arm = load(path)
    path.unlink()
    return arm
