"""A short arm, so that tests can enumerate its configurations, and a separate cache folder."""

from collections.abc import Iterator

import pytest

import hyperbit as hb


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("CACHE_DIRECTORY", raising=False)
        yield


@pytest.fixture(scope="session")
def arm() -> hb.Arm:
    return hb.Arm([hb.vgt("BC", width=0.2, lengths=(0.2, 0.25), count=4)], name="short", tolerance=0.01)
