"""The page in a browser behind a proxy that serves it under a sub-path."""

import asyncio
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hyperbit.controller.panel.access.people import digest_of
from tests.browser.conftest import started
from tests.browser.rig import OPERATOR, Shown, eventually
from tests.endpoints import free_endpoint, free_port
from tests.forwarding import Forwarder, passed
from tests.network.played import listening

pytestmark = pytest.mark.timeout(600)

PREFIX = "/hyperbit"


class Proxy(Forwarder):
    """Passes requests below PREFIX to a page on this computer, with a Host of its own, as nginx does by default."""

    async def connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        there, to = await asyncio.open_connection("127.0.0.1", self.target)
        assert f" {PREFIX}/" in head.partition("\r\n")[0], "the page asks below its own path only"
        head = head.replace(f" {PREFIX}/", " /", 1).replace(
            f"Host: 127.0.0.1:{self.port}", f"Host: 127.0.0.1:{self.target}"
        )
        to.write((head if "Upgrade" in head else head.replace("\r\n", "\r\nConnection: close\r\n", 1)).encode())
        await asyncio.gather(passed(reader, to), passed(there, writer))


@pytest.fixture
def shown(tmp_path: Path, driver: object) -> Iterator[Shown]:
    with ExitStack() as closing:
        endpoint, page = free_endpoint(), free_port()
        listening(closing, endpoint)
        proxy = Proxy(page)
        closing.callback(proxy.close)
        url = f"http://127.0.0.1:{proxy.port}{PREFIX}"
        people = tmp_path / "people.yaml"
        people.write_text(f"people: [{{name: anna, role: operator, token: {digest_of(OPERATOR)}}}]\n")
        words = ["panel", "--listen", f"127.0.0.1:{page}", "--people", str(people), "--connect", endpoint]
        started([*words, "--public", url], tmp_path, closing)
        eventually(lambda: f"hyperbit panel, {url}/" in (tmp_path / "log").read_text())
        yield Shown(driver, url)
        driver.get("about:blank")  # type: ignore[attr-defined]


def test_the_page_works_below_a_sub_path(shown: Shown) -> None:
    shown.visit("/", OPERATOR)
    shown.says(".arms", "planar16")
    shown.press(".arms a")
    shown.says("#control", "You are anna, operator")
    shown.one(".stage canvas")
    shown.one("#stop").click()
    shown.says(".notice", "Stop: stopped")
    origins = shown.run("return performance.getEntriesByType('resource').map((entry) => new URL(entry.name).pathname)")
    assert all(path.startswith(f"{PREFIX}/") for path in origins)
    shown.press(".home")
    shown.says(".arms", "planar16")
