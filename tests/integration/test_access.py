"""Who may command and who may only look: the shipped Zenoh configuration with certificates of the shipped script."""

import itertools
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import can
import msgspec
import pytest
import zenoh

from controller.config import Arm
from controller.daemon import session
from controller.daemon.client import Client, Unanswered
from controller.daemon.follower import Follower
from controller.daemon.inbox import Inbox
from controller.daemon.planner import Planner
from controller.daemon.service import Daemon, timing_of
from controller.daemon.tip import TipWatch
from controller.settings import TrackerSettings
from controller.workspace.densities import Densities
from drivers.simulation.simulation import Simulation
from drivers.wiring import Timing, Wiring
from tests.daemon.waiting import PATIENCE, eventually
from tests.integration.conftest import Bench, enduring
from tests.integration.harness import KEYS, Observer
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT, drain, syncs
from tests.keys import DEPLOY, certificates, made, openssl

pytestmark = pytest.mark.skipif(not made(), reason="openssl is missing")

COMMANDS = ("goal", "setpoint", "measured_tip", "cancel", "stop", "reset", "degrade", "obstacles")
CREDENTIALS = "/run/credentials/hyperbit.service/hyperbit."
PREFIX = "hyperbit/planar16"
AT_ONCE = 0.5  # [s] for an answer that shall not come


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority's, the daemon's with the shipped configuration, an operator's, a viewer's, and one nobody listed."""
    keys = certificates(tmp_path_factory.mktemp("access") / "keys", clients=("operator", "viewer", "former"))
    shipped = (DEPLOY / "zenoh-tls.json5").read_text()
    assert shipped.count(CREDENTIALS) == 3
    (keys / "daemon" / "zenoh.json5").write_text(shipped.replace(CREDENTIALS, ""))
    return keys


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tls/localhost:{free.getsockname()[1]}"


class GuardedBench(Bench):
    """Starts daemons that ask for certificates, and sessions that show one."""

    keys: Path

    def config(self, who: str) -> zenoh.Config:
        """The configuration in a folder of the keys', but for the port."""
        config = session.from_file(self.keys / who / "zenoh.json5")
        config.insert_json5(f"{'listen' if who == 'daemon' else 'connect'}/endpoints", json.dumps([self.endpoint]))
        return config

    def daemon(self, timing: Timing | None = None) -> Daemon:
        timing = timing or enduring(timing_of(self.arm))
        return Daemon(self.arm, self._densities, self._wiring, self.config("daemon"), self.ledger, timing)

    def session(self, who: str = "operator") -> zenoh.Session:
        return self.stack.enter_context(zenoh.open(self.config(who)))

    def observer(self, who: str = "operator") -> Observer:
        return Observer(Client(self.session(who), self.arm.settings.name))


@pytest.fixture
def bench(
    arm: Arm, densities: Densities, wiring: Wiring, endpoint: str, tmp_path: Path, keys: Path
) -> Iterator[GuardedBench]:
    with ExitStack() as stack:
        settings = msgspec.structs.replace(arm.settings, tracker=TrackerSettings(noise=1e-4, clamp=0.01))
        guarded = GuardedBench(
            stack, replace(arm, settings=settings), densities, wiring, endpoint, tmp_path / "ledger.sqlite"
        )
        guarded.keys = keys
        yield guarded


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Payloads of goals, plans, setpoints and measured tips, and the kinds of other requests, that the daemon sees."""
    seen: list[bytes] = []

    def see(kind: type, name: str, content: Callable[..., bytes]) -> None:
        take = getattr(kind, name)
        monkeypatch.setattr(kind, name, lambda self, *given: (seen.append(content(*given)), take(self, *given))[1])

    see(Planner, "submit", lambda question: question.payload)
    see(Follower, "take", lambda payload, arrival: payload)
    see(TipWatch, "take", lambda payload: payload)
    see(Inbox, "hand_over", lambda request: type(request).__name__.encode())
    return seen


def answers(session: zenoh.Session, key: str, payload: bytes = b"") -> list[bool]:
    """Whether each answer is one, of all that come at once."""
    return [reply.ok is not None for reply in session.get(f"{PREFIX}/{key}", payload=payload, timeout=AT_ONCE)]


def test_an_operator_commands(requests: list[bytes], client: Observer, bench: GuardedBench, boards: Simulation) -> None:
    assert client.ask("arm")["name"] == "planar16"
    assert client.ask("plan", waypoints=[{"position": MIDDLE}])["accepted"]
    client.move(MIDDLE)
    assert client.client.run({"waypoints": [{"position": RIGHT}]})["status"] == "succeeded"
    client.goal(LEFT, RIGHT, times=[0, HOUR], id="a")
    assert client.ask("cancel")["accepted"]
    assert client.result("a")["status"] == "canceled"
    bench.session().put(f"{PREFIX}/measured_tip", b"a tip")
    eventually(lambda: b"a tip" in requests)
    publisher = bench.session().declare_publisher(f"{PREFIX}/setpoint")
    before = boards.switches().sum()

    def followed() -> bool:
        publisher.put(json.dumps({"position": MIDDLE}))
        return bool(boards.switches().sum() > before)

    eventually(followed)
    client.wait_now("ready")
    assert "none of this arm's" in client.ask("degrade", actuator="17.left", state=None)["message"]
    assert client.ask("obstacles", regions=[])["accepted"]
    assert client.ask("stop")["accepted"]
    client.wait_now("stopped")
    assert client.ask("reset")["accepted"]
    client.wait_now("ready")


def test_a_viewer_sees_all_and_moves_nothing(
    requests: list[bytes], client: Observer, bench: GuardedBench, boards: Simulation, listener: can.BusABC
) -> None:
    viewer = bench.observer("viewer")
    client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="a")
    eventually(lambda: viewer.feedback("a"))
    assert viewer.wait_for("executing")["goal"] == "a"
    eventually(lambda: viewer.heard["diagnostics"])
    assert viewer.client.alive()
    assert viewer.ask("arm") == client.ask("arm")

    requests.clear()
    drain(listener)
    before = boards.switches().tolist()
    session = bench.session("viewer")
    goal = json.dumps({"waypoints": [{"position": LEFT}]}).encode()
    for name in COMMANDS:
        for key in (f"{PREFIX}/{name}", f"hyperbit/*/{name}", f"{PREFIX}/*", "hyperbit/**", "**"):
            session.put(key, goal)
            session.delete(key)
    for key in (*COMMANDS, "plan", "*", "**"):
        assert answers(session, key, goal) == [], key
    with pytest.raises(Unanswered, match="took no stop of ours: not allowed"):
        viewer.client.request("stop", timeout=AT_ONCE)
    eventually(lambda: answers(session, "arm") == [True])  # after all of them, on the same way
    assert requests == []
    assert client.wait_now("executing")["goal"] == "a"
    assert boards.switches().tolist() == before
    assert syncs(drain(listener)) == []
    assert client.ask("cancel")["accepted"]
    assert requests == [b"Cancel"]
    assert viewer.result("a")["status"] == "canceled"


def test_a_viewer_cannot_pass_for_the_daemon(client: Observer, bench: GuardedBench) -> None:
    session = bench.session("viewer")
    for key in (*KEYS, "*"):
        session.put(f"{PREFIX}/{key}", b'{"mode": "stopped", "reason": "faked"}')
    heard: list[str] = []
    for key in ("goal", "arm", "**"):
        session.declare_queryable(f"{PREFIX}/{key}", lambda query: heard.append("a query"), complete=True)
    session.declare_subscriber(f"{PREFIX}/goal", lambda sample: heard.append("a goal"))
    session.declare_subscriber("hyperbit/**", lambda sample: heard.append(str(sample.key_expr)))
    session.liveliness().declare_token("hyperbit/other/alive")
    eventually(lambda: True in answers(session, "arm"))  # after all of them, on the same way
    heard.clear()
    assert client.ask("arm")["name"] == "planar16"
    bench.session().put(f"{PREFIX}/goal", b"{}")
    client.move(MIDDLE)
    assert not Client(bench.session(), "other").alive(AT_ONCE)
    assert {key.removeprefix(f"{PREFIX}/") for key in heard} <= set(KEYS), "only what the daemon tells"
    assert not any("faked" in str(message) for key in KEYS for message in client.heard[key])


def connects(config: zenoh.Config) -> bool:
    try:
        with zenoh.open(config):
            return True
    except zenoh.ZError:
        return False


def foreign(bench: GuardedBench, folder: Path) -> zenoh.Config:
    """An operator of another authority, who trusts this daemon."""
    certificates(folder, clients=("operator",))
    (folder / "operator" / "ca.pem").write_bytes((bench.keys / "ca" / "certificate.pem").read_bytes())
    bench.keys = folder
    return bench.config("operator")


def expired(bench: GuardedBench, folder: Path) -> zenoh.Config:
    """An operator whose certificate ended yesterday."""
    folder.mkdir()
    ca, operator = bench.keys / "ca", bench.keys / "operator"
    old, request, purpose = (str(folder / name) for name in ("old.pem", "request", "purpose"))
    Path(purpose).write_text("basicConstraints = CA:FALSE\nextendedKeyUsage = clientAuth\n")
    openssl("req", "-new", "-key", str(operator / "key.pem"), "-subj", "/CN=operator", "-out", request)
    sign = ["x509", "-req", "-in", request, "-CA", str(ca / "certificate.pem"), "-CAkey", str(ca / "key.pem")]
    assert openssl(*sign, "-set_serial", "7", "-days", "-1", "-extfile", purpose, "-out", old).returncode == 0
    config = bench.config("operator")
    config.insert_json5("transport/link/tls/connect_certificate", json.dumps(old))
    return config


def without(bench: GuardedBench, folder: Path) -> zenoh.Config:
    """Somebody who shows no certificate."""
    config = bench.config("operator")
    config.insert_json5("transport/link/tls/enable_mtls", "false")
    return config


def unencrypted(bench: GuardedBench, folder: Path) -> zenoh.Config:
    """Somebody who speaks no TLS."""
    return session.configuration("client", connect=bench.endpoint.replace("tls/", "tcp/"))


def daemons(bench: GuardedBench, folder: Path) -> zenoh.Config:
    """Somebody who has the daemon's own certificate and key, good for listening only."""
    config = bench.config("operator")
    for name, file in (("connect_certificate", "certificate.pem"), ("connect_private_key", "key.pem")):
        config.insert_json5(f"transport/link/tls/{name}", json.dumps(str(bench.keys / "daemon" / file)))
    return config


@pytest.mark.parametrize("stranger", [foreign, expired, without, unencrypted, daemons])
def test_strangers_do_not_connect(
    client: Observer, bench: GuardedBench, tmp_path: Path, stranger: Callable[[GuardedBench, Path], zenoh.Config]
) -> None:
    assert connects(bench.config("operator")), "or else nobody would"
    assert not connects(stranger(bench, tmp_path / "strange"))
    client.move(MIDDLE)


def test_who_is_listed_no_more_neither_sees_nor_commands(
    requests: list[bytes], client: Observer, bench: GuardedBench
) -> None:
    former = bench.observer("former")
    assert not former.client.alive(AT_ONCE)
    for key in ("arm", "plan", "stop"):
        with pytest.raises(Unanswered):
            former.client.request(key, timeout=AT_ONCE)
    client.move(MIDDLE)
    eventually(lambda: client.heard["diagnostics"])
    assert not any(former.heard.values())
    assert b"Stop" not in requests


def test_what_is_too_large_does_not_get_through(
    requests: list[bytes], client: Observer, bench: GuardedBench, daemon: Daemon
) -> None:
    session = bench.session()
    for size in (2_100_000, 20_000_000):
        session.put(f"{PREFIX}/goal", bytes(size))
        session.put(f"{PREFIX}/stop", bytes(size))
        assert answers(session, "goal", bytes(size)) != [True]
    assert requests == []
    large = bytes(1_500_000)  # a slow machine may have lost the connection over the 20 MB
    (reply,) = eventually(lambda: list(session.get(f"{PREFIX}/goal", payload=large, timeout=PATIENCE)))
    assert "1500000 bytes, at most" in json.loads(reply.ok.payload.to_bytes())["message"]
    client.move(MIDDLE)


def test_a_flood_is_thinned_out_and_holds_up_nobody(
    requests: list[bytes], client: Observer, bench: GuardedBench, daemon: Daemon
) -> None:
    session, sent = bench.session(), 20_000
    begun = time.monotonic()
    for k in range(sent):
        key = ("goal", "setpoint")[k % 2]
        session.put(f"{PREFIX}/{key}", b"{}", congestion_control=zenoh.CongestionControl.BLOCK)
    tries = itertools.count()
    eventually(lambda: client.goal(MIDDLE, id=f"goal {next(tries)}")["accepted"])  # a slow planner is busy at first
    assert client.result(client.accepted[-1])["status"] == "succeeded"
    eventually(lambda: requests.count(b"{}") > 1)
    assert requests.count(b"{}") <= 2 * (1000 * (time.monotonic() - begun) + 1), "1000 a second of each"
    session.put(f"{PREFIX}/stop", b"")  # never thinned out
    session.put(f"{PREFIX}/cancel", b"")
    client.wait_now("stopped")
