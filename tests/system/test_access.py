"""Rights of clients: the shipped Zenoh configuration, with certificates from the shipped script."""

import itertools
import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.planning.core.events import Key, Message, SetpointArrived, TipArrived
from hyperbit.controller.planning.loop import Mailbox
from hyperbit.controller.planning.planner import RequestDecoder
from hyperbit.drivers.simulation.simulation import Simulation
from tests.keys import DEPLOY, certificates, made, openssl
from tests.system.stack.motions import Motions
from tests.system.stack.observer import KEYS, Observer
from tests.system.stack.places import HOUR, LEFT, MIDDLE, RIGHT
from tests.system.stack.system import System
from tests.waiting import PATIENCE, eventually

pytestmark = [
    pytest.mark.buses("virtual"),
    pytest.mark.skipif(not made(), reason="openssl is missing"),
    pytest.mark.arm(name="planar16", tracker={"noise": 1e-4, "clamp": 0.01}),
]

PREFIX = "hyperbit/planar16"
AT_ONCE = 0.5  # [s] in which an unwanted answer would arrive
COMMANDS = ("goal", "jog", "setpoint", "measured_tip", "cancel", "stop", "reset", "degrade", "obstacles")
CREDENTIALS = "/run/credentials/hyperbit@arm.service/hyperbit."


class Guard:
    def __init__(self, system: System, keys: Path, stack: ExitStack) -> None:
        self.system, self.keys, self.stack = system, keys, stack

    def config(self, who: str) -> zenoh.Config:
        """The configuration in the keys' folder, with another port."""
        config = session.from_file(self.keys / who / "zenoh.json5")
        endpoint = self.system.endpoint.replace("tcp/127.0.0.1", "tls/localhost")
        config.insert_json5(f"{'listen' if who == 'daemon' else 'connect'}/endpoints", json.dumps([endpoint]))
        return config

    def session(self, who: str = "operator") -> zenoh.Session:
        return self.stack.enter_context(zenoh.open(self.config(who)))

    def observer(self, who: str = "operator") -> Observer:
        return Observer(Client(self.session(who), "planar16"))


class Seen:
    """The requests that reach a planner: keys and payloads, in order."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.all: list[tuple[str, bytes]] = []
        seen = self.all

        decode, take = RequestDecoder.decode, Mailbox.take

        def decoding(self: RequestDecoder, key: Key, payload: bytes) -> Message:
            seen.append((key, payload))
            return decode(self, key, payload)

        def taking(self: Mailbox) -> list[SetpointArrived | TipArrived]:
            latest = take(self)
            keys = {SetpointArrived: "setpoint", TipArrived: "measured_tip"}
            seen.extend((keys[type(arrived)], arrived.payload) for arrived in latest)
            return latest

        monkeypatch.setattr(RequestDecoder, "decode", decoding)
        monkeypatch.setattr(Mailbox, "take", taking)


def answers(session: zenoh.Session, key: str, payload: bytes = b"") -> list[bool]:
    """Whether each answer is accepted, of all that arrive at once."""
    return [reply.ok is not None for reply in session.get(f"{PREFIX}/{key}", payload=payload, timeout=AT_ONCE)]


def connects(config: zenoh.Config) -> bool:
    try:
        with zenoh.open(config):
            return True
    except zenoh.ZError:
        return False


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates: the authority's, the daemon's, an operator's, a viewer's, and one that is not listed."""
    keys = certificates(tmp_path_factory.mktemp("access") / "keys", clients=("operator", "viewer", "former"))
    shipped = (DEPLOY / "zenoh-tls.json5").read_text()
    assert shipped.count(CREDENTIALS) == 3
    (keys / "daemon" / "zenoh.json5").write_text(shipped.replace(CREDENTIALS, ""))
    return keys


@pytest.fixture(scope="module")
def patching() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patching:
        yield patching


@pytest.fixture(scope="module")
def seen(patching: pytest.MonkeyPatch) -> Seen:
    return Seen(patching)


@pytest.fixture
def guard(seen: Seen, system: System, keys: Path, stack: ExitStack) -> Guard:
    """The arm's planner requires certificates."""
    guard = Guard(system, keys, stack)
    if system.config is None:
        system.end_planner()
        system.config, system.clients = guard.config("daemon"), lambda: guard.config("operator")
        system.start_planner()
    return guard


@pytest.fixture
def client(guard: Guard, motions: Motions, seen: Seen) -> Iterator[Observer]:
    """An operator; at the end, all motion was for goals."""
    client = guard.observer()
    client.wait_for("ready")
    seen.all.clear()
    yield client
    motions.check(client, guard.system.boards)


def test_an_operator_commands(seen: Seen, client: Observer, guard: Guard, boards: Simulation) -> None:
    assert client.ask("arm")["name"] == "planar16"
    assert client.ask("plan", waypoints=[{"position": MIDDLE}])["accepted"]
    client.move(MIDDLE)
    client.goal(LEFT, RIGHT, times=[0, HOUR], id="a")
    assert client.ask("cancel")["accepted"]
    assert client.result("a")["status"] == "canceled"
    guard.session().put(f"{PREFIX}/measured_tip", b"a tip")
    eventually(lambda: ("measured_tip", b"a tip") in seen.all)
    guard.session().put(f"{PREFIX}/setpoint", b"a set-point")
    eventually(lambda: ("setpoint", b"a set-point") in seen.all)
    assert "is no actuator of this arm" in client.ask("degrade", actuator="17.left", state=None)["message"]
    assert "is no actuator of this arm" in client.ask("jog", actuators={"17.left": "extended"})["message"]
    assert client.ask("obstacles", regions=[])["accepted"]
    assert client.ask("stop")["accepted"]
    client.wait_now("stopped")
    client.reset()


def test_a_viewer_sees_all_and_moves_nothing(seen: Seen, client: Observer, guard: Guard, motions: Motions) -> None:
    viewer = guard.observer("viewer")
    client.move(LEFT)
    client.goal(MIDDLE, RIGHT, times=[0, HOUR], id="a")
    eventually(lambda: viewer.feedback("a"))
    assert viewer.wait_now("executing")["goal"] == "a"
    eventually(lambda: viewer.heard["diagnostics"])
    assert viewer.client.alive()
    assert viewer.ask("arm") == client.ask("arm")

    seen.all.clear()
    motions.clear()
    session = guard.session("viewer")
    goal = json.dumps({"waypoints": [{"position": LEFT}]}).encode()
    for name in COMMANDS:
        for key in (f"{PREFIX}/{name}", f"hyperbit/*/{name}", f"{PREFIX}/*", "hyperbit/**", "**"):
            session.put(key, goal)
            session.delete(key)
    for key in (*COMMANDS, "plan", "*", "**"):
        assert answers(session, key, goal) == [], key
    with pytest.raises(Unanswered, match="did not accept this stop"):
        viewer.client.request("stop", timeout=AT_ONCE)
    eventually(lambda: answers(session, "arm") == [True])  # after all of them, on the same way
    assert seen.all == []
    assert client.wait_now("executing")["goal"] == "a"
    assert motions.still()
    assert client.ask("cancel")["accepted"]
    assert seen.all == [("cancel", b"{}")]
    assert viewer.result("a")["status"] == "canceled"


def test_a_viewer_cannot_pass_for_the_daemon(client: Observer, guard: Guard) -> None:
    session = guard.session("viewer")
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
    guard.session().put(f"{PREFIX}/goal", b"{}")
    client.move(MIDDLE)
    assert not Client(guard.session(), "other").alive(AT_ONCE)
    assert {key.removeprefix(f"{PREFIX}/") for key in heard} <= set(KEYS), "only what the daemon tells"
    assert not any("faked" in str(message) for key in KEYS for message in client.heard[key])


def foreign(guard: Guard, folder: Path) -> zenoh.Config:
    """An operator of another authority, who trusts this daemon."""
    certificates(folder, clients=("operator",))
    (folder / "operator" / "ca.pem").write_bytes((guard.keys / "ca" / "certificate.pem").read_bytes())
    return Guard(guard.system, folder, guard.stack).config("operator")


def expired(guard: Guard, folder: Path) -> zenoh.Config:
    """An operator whose certificate ended yesterday."""
    folder.mkdir()
    ca, operator = guard.keys / "ca", guard.keys / "operator"
    old, request, purpose = (str(folder / name) for name in ("old.pem", "request", "purpose"))
    Path(purpose).write_text("basicConstraints = CA:FALSE\nextendedKeyUsage = clientAuth\n")
    openssl("req", "-new", "-key", str(operator / "key.pem"), "-subj", "/CN=operator", "-out", request)
    sign = ["x509", "-req", "-in", request, "-CA", str(ca / "certificate.pem"), "-CAkey", str(ca / "key.pem")]
    assert openssl(*sign, "-set_serial", "7", "-days", "-1", "-extfile", purpose, "-out", old).returncode == 0
    config = guard.config("operator")
    config.insert_json5("transport/link/tls/connect_certificate", json.dumps(old))
    return config


def without(guard: Guard, folder: Path) -> zenoh.Config:
    """A client without a certificate."""
    config = guard.config("operator")
    config.insert_json5("transport/link/tls/enable_mtls", "false")
    return config


def unencrypted(guard: Guard, folder: Path) -> zenoh.Config:
    """A client without TLS."""
    return session.configuration("client", connect=guard.system.endpoint)


def daemons(guard: Guard, folder: Path) -> zenoh.Config:
    """A client with the daemon's own certificate and key, which are valid for listening only."""
    config = guard.config("operator")
    for name, file in (("connect_certificate", "certificate.pem"), ("connect_private_key", "key.pem")):
        config.insert_json5(f"transport/link/tls/{name}", json.dumps(str(guard.keys / "daemon" / file)))
    return config


@pytest.mark.parametrize("stranger", [foreign, expired, without, unencrypted, daemons])
def test_strangers_do_not_connect(
    guard: Guard, tmp_path: Path, stranger: Callable[[Guard, Path], zenoh.Config]
) -> None:
    assert connects(guard.config("operator")), "or else nobody would"
    assert not connects(stranger(guard, tmp_path / "strange"))


def test_who_is_listed_no_more_neither_sees_nor_commands(seen: Seen, client: Observer, guard: Guard) -> None:
    former = guard.observer("former")
    assert not former.client.alive(AT_ONCE)
    for key in ("arm", "plan", "stop"):
        with pytest.raises(Unanswered):
            former.client.request(key, timeout=AT_ONCE)
    client.move(MIDDLE)
    client.diagnosed()
    assert not any(former.heard.values())
    assert "stop" not in [key for key, _ in seen.all]


def test_what_is_too_large_does_not_get_through(seen: Seen, client: Observer, guard: Guard) -> None:
    session = guard.session()
    for size in (2_100_000, 20_000_000):
        session.put(f"{PREFIX}/goal", bytes(size))
        session.put(f"{PREFIX}/stop", bytes(size))
        assert answers(session, "goal", bytes(size)) != [True]
    assert seen.all == []
    large = bytes(1_500_000)  # a slow machine may have lost the connection over 20 MB
    (reply,) = eventually(lambda: list(session.get(f"{PREFIX}/goal", payload=large, timeout=PATIENCE)))
    assert "1500000 bytes, at most" in json.loads(reply.ok.payload.to_bytes())["message"]
    client.move(MIDDLE)


def test_a_flood_is_thinned_out_and_holds_up_nobody(seen: Seen, client: Observer, guard: Guard) -> None:
    session, sent = guard.session(), 20_000
    for k in range(sent):
        key = ("goal", "setpoint")[k % 2]
        session.put(f"{PREFIX}/{key}", b"{}", congestion_control=zenoh.CongestionControl.BLOCK)
    tries = itertools.count()
    eventually(lambda: client.goal(MIDDLE, id=f"goal {next(tries)}")["accepted"])  # a slow planner is busy at first
    assert client.result(client.accepted[-1])["status"] == "succeeded"
    assert len(seen.all) < sent, "most of them reach nobody"
    for key in ("stop", "cancel"):  # never dropped by Zenoh's downsampling; BLOCK, because the queue may still be full
        session.put(f"{PREFIX}/{key}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
    client.wait_now("stopped")
    client.reset()
