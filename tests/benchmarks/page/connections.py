"""Times of a stop, of a log-in and of the page beside idle connections: at four addresses, then through a proxy.

python -m tests.benchmarks.page.connections
"""

import resource
import socket
import statistics
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from hyperbit.controller.panel.access.people import digest_of
from tests.endpoints import free_endpoint, free_port
from tests.forwarding import Forwarder
from tests.network.played import listening
from tests.panel.conftest import OPERATOR
from tests.panel.test_connections import Visit
from tests.panel.test_server import running
from tests.waiting import PATIENCE, eventually

EACH = 20  # times of each kind
PAUSE = 0.12  # [s]; a page sends ten stops a second at most
DIRECT, BEHIND = 2_000, 600  # idle connections


def timed(act: Callable[[], object]) -> str:
    took = []
    for _ in range(EACH):
        began = time.monotonic()
        assert act()
        took.append(time.monotonic() - began)
        time.sleep(PAUSE)
    return f"{statistics.median(took) * 1e3:.0f}, {max(took) * 1e3:.0f} ms"


def show(what: str, url: str) -> None:
    with ExitStack() as closing:
        visit = Visit(url, closing)
        eventually(visit.stops)
        over_the_page = timed(visit.stops_from_the_page)
    page = timed(lambda: visit.request("/", "GET").read())
    times = f"stop over HTTP {timed(visit.stops)}; over the page {over_the_page}; log-in {timed(visit.log_in)}"
    print(f"{what}: {times}; page {page} (median, most)")


def main() -> None:
    endpoint, port = free_endpoint(), free_port()
    with ExitStack() as closing:
        folder = Path(closing.enter_context(tempfile.TemporaryDirectory()))
        people = folder / "people.yaml"
        people.write_text(f"people: [{{name: anna, role: operator, token: {digest_of(OPERATOR)}}}]\n")
        listening(closing, endpoint)
        proxy = Forwarder(port)
        closing.callback(proxy.close)
        public = f"http://127.0.0.1:{proxy.port}"
        words = ["--listen", f"127.0.0.1:{port}", "--people", str(people), "--connect", endpoint, "--public", public]
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (1024, hard))  # of a service
        closing.enter_context(running(folder, *words))
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        show("no idle connection", f"http://127.0.0.1:{port}")
        for count, target, sources in ((DIRECT, port, 4), (BEHIND, proxy.port, 1)):
            idle = []
            for k in range(count):
                own = (f"127.0.0.{k % sources + 1}", 0)
                idle.append(closing.enter_context(socket.create_connection(("127.0.0.1", target), PATIENCE, own)))
            where = "at four addresses" if target == port else "through a proxy"
            show(f"{count} idle connections {where}", f"http://127.0.0.1:{target}")
            for connection in idle:
                connection.close()


if __name__ == "__main__":
    main()
