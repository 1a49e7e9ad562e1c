"""The cache of densities: files are reused, but never if damaged or of another arm."""

import io
import logging

import numpy as np
import pytest

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.workspace.cache import default_directory, key, load, load_or_map, store
from hyperbit.controller.workspace.mapping import map_densities
from tests.arms import paper_arm, spatial_arm

ARM = paper_arm(3)
PIXEL, LEVEL_PIXELS = 0.05, 10_000
KEY = key(ARM, PIXEL, LEVEL_PIXELS)


@pytest.fixture
def path(tmp_path):
    load_or_map(ARM, PIXEL, LEVEL_PIXELS, tmp_path)
    (path,) = tmp_path.iterdir()
    return path


def levels_mapped(directory) -> int:
    """Loads ARM's densities, compares them with new ones, and returns the number of levels mapped."""
    done: list[int] = []
    found = load_or_map(ARM, PIXEL, LEVEL_PIXELS, directory, done.append)
    for name, expected in vars(map_densities(ARM, PIXEL, LEVEL_PIXELS)).items():
        actual = getattr(found, name)
        assert actual.dtype == expected.dtype
        assert np.array_equal(actual, expected)
    return len(done)


def test_the_second_time_nothing_is_mapped(tmp_path):
    folder = tmp_path / "not" / "yet" / "there"
    assert [levels_mapped(folder), levels_mapped(folder)] == [4, 0]


@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, -1])
def test_a_file_cut_short_is_built_anew(path, caplog, kept):
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * kept) if isinstance(kept, float) else kept])
    assert levels_mapped(path.parent) == 4
    assert f"{path} was damaged" in caplog.text
    assert path.read_bytes() == whole


def test_no_flipped_byte_goes_unnoticed(tmp_path, caplog):
    path, densities = tmp_path / "small.npz", map_densities(paper_arm(1), 0.2, 100)
    store(path, KEY, densities)
    whole = bytearray(path.read_bytes())
    caplog.set_level(logging.CRITICAL)
    for k in range(len(whole)):
        whole[k] ^= 0x11
        path.write_bytes(whole)
        whole[k] ^= 0x11
        found = load(path, KEY)
        # Bytes that hold no content, such as a member's date, may change without harm.
        assert found is None or all(
            np.array_equal(value, vars(found)[name]) and value.dtype == vars(found)[name].dtype
            for name, value in vars(densities).items()
        )


def without_values() -> bytes:
    """An archive with the right key but without one array."""
    buffer = io.BytesIO()
    np.savez(buffer, key=np.array(KEY), offsets=np.zeros(3))
    return buffer.getvalue()


def bare_array() -> bytes:
    """An array instead of an archive."""
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    return buffer.getvalue()


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", bare_array(), without_values()])
def test_a_file_of_something_else_is_built_anew(path, caplog, content):
    path.write_bytes(content)
    assert levels_mapped(path.parent) == 4
    assert "are built anew" in caplog.text


def test_densities_of_another_arm_are_built_anew(path, caplog):
    foreign = key(paper_arm(2), PIXEL, LEVEL_PIXELS)
    store(path, foreign, map_densities(paper_arm(2), PIXEL, LEVEL_PIXELS))
    assert levels_mapped(path.parent) == 4
    assert f"it holds densities of {foreign}, not of {KEY}" in caplog.text


def test_a_folder_that_cannot_be_written_is_only_warned_of(tmp_path, caplog):
    file = tmp_path / "file"
    file.touch()
    assert levels_mapped(file / "folder") == 4
    assert "densities are not kept" in caplog.text


def test_a_write_that_fails_leaves_the_old_file_and_no_other(path, monkeypatch):
    whole = path.read_bytes()

    def full_disk(*args, **kwargs):
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(OSError, match="no space left"):
        store(path, KEY, map_densities(ARM, PIXEL, LEVEL_PIXELS))
    assert [p.read_bytes() for p in path.parent.iterdir()] == [whole]


def test_the_key_tells_geometries_and_pixels_apart():
    shifted = Manipulator([*ARM.modules[:2], ARM.modules[1]])
    keys = {KEY, key(ARM, 0.06, LEVEL_PIXELS), key(ARM, PIXEL, 10_001)}
    keys |= {key(arm, PIXEL, LEVEL_PIXELS) for arm in (shifted, paper_arm(2), paper_arm(4), spatial_arm(3))}
    assert len(keys) == 7


def test_the_key_does_not_ask_where_the_base_is():
    moved = Manipulator(ARM.modules, frames.planar(3, 4, 1))
    assert key(moved, PIXEL, LEVEL_PIXELS) == KEY


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"CACHE_DIRECTORY": "/var/cache/hyperbit"}, "/var/cache/hyperbit/densities"),
        ({"XDG_CACHE_HOME": "/x"}, "/x/hyperbit"),
        ({"XDG_CACHE_HOME": "", "HOME": "/home/me"}, "/home/me/.cache/hyperbit"),
    ],
)
def test_the_folder_is_systemds_or_the_users(monkeypatch, environment, expected):
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert str(default_directory()) == expected
