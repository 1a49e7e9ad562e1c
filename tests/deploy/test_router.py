"""The shipped configuration of a cell's router: what passes its border, with certificates from the shipped script."""

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hyperbit.controller.commands.operate.router import router_config
from hyperbit.controller.gateway.claim import AlreadyRunning, Claim
from hyperbit.controller.network import session
from hyperbit.controller.network.fleet import ArmAddress, Fleet, alive
from hyperbit.controller.network.stop_all import stop_all
from tests.endpoints import free_endpoint
from tests.keys import DEPLOY, certificates, made
from tests.network.played import PlayedArm
from tests.waiting import PATIENCE, eventually

pytestmark = pytest.mark.skipif(not made(), reason="openssl is missing")

HERE, THERE = ArmAddress("", "planar16"), ArmAddress("cell1", "planar16")
CREDENTIALS = "/run/credentials/hyperbit-router.service/hyperbit."


class Cell:
    """A router with the shipped configuration, and an arm in each of two namespaces; viewers and operators outside."""

    def __init__(self, stack: ExitStack, keys: Path) -> None:
        self._stack, self._keys = stack, keys
        self.inside, self.outside = free_endpoint(), free_endpoint().replace("tcp/127.0.0.1", "tls/localhost")
        self._plant = free_endpoint().replace("tcp/127.0.0.1", "tls/localhost")
        file = keys / "daemon" / "router.json5"
        file.write_text((DEPLOY / "zenoh-router.json5").read_text().replace(CREDENTIALS, ""))
        plant = self._router(file, "plant", self._plant)
        plant.insert_json5("access_control", "{enabled: false}")
        cell = self._router(file, "cell", self.inside, self.outside)
        cell.insert_json5("connect/endpoints", json.dumps([self._plant]))
        for config in (plant, cell):
            stack.enter_context(zenoh.open(config))
        self.arms = [PlayedArm(stack, self._config(self.inside, namespace), "planar16") for namespace in ("", "cell1")]

    def _router(self, file: Path, name: str, *listen: str) -> zenoh.Config:
        """The shipped configuration at other endpoints, with a client's certificate to connect with."""
        config = router_config("", None, file)
        config.insert_json5("listen/endpoints", json.dumps(listen))
        for part, pem in (("certificate", "certificate.pem"), ("private_key", "key.pem")):
            config.insert_json5(f"transport/link/tls/connect_{part}", json.dumps(str(self._keys / name / pem)))
        return config

    def _config(self, endpoint: str, namespace: str = "") -> zenoh.Config:
        config = session.configuration("client", connect=endpoint)
        if namespace:
            config.insert_json5("namespace", json.dumps(namespace))
        return config

    def open(self, who: str) -> zenoh.Session:
        """Opens a session of somebody `inside`, of an outsider with a certificate, or of one in the `plant`."""
        if who == "inside":
            return self._stack.enter_context(zenoh.open(self._config(self.inside)))
        config = session.from_file(self._keys / ("operator" if who == "plant" else who) / "zenoh.json5")
        config.insert_json5("connect/endpoints", json.dumps([self._plant if who == "plant" else self.outside]))
        return self._stack.enter_context(zenoh.open(config))


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return certificates(tmp_path_factory.mktemp("keys") / "keys", clients=("operator", "viewer", "cell", "plant"))


@pytest.fixture(scope="module")
def cell(keys: Path) -> Iterator[Cell]:
    with ExitStack() as stack:
        yield Cell(stack, keys)


def reached(cell: Cell, who: str) -> zenoh.Session:
    opened = cell.open(who)
    eventually(lambda: alive(opened) == [HERE, THERE], told=lambda: str(alive(opened)))
    return opened


def answered(opened: zenoh.Session, key: str) -> set[str]:
    replies = opened.get(key, target=zenoh.QueryTarget.ALL, timeout=PATIENCE)
    return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}


@pytest.mark.parametrize(
    ("who", "may_command"), [("inside", True), ("operator", True), ("viewer", False), ("plant", False)]
)
def test_all_may_watch_and_stop_and_few_may_command(cell: Cell, who: str, may_command: bool) -> None:
    opened = reached(cell, who)
    for key in ("arm", "stop"):
        eventually(
            lambda key=key: answered(opened, f"**/hyperbit/*/{key}") == {f"{it.prefix}/{key}" for it in (HERE, THERE)}
        )
    for arm, address in zip(cell.arms, (HERE, THERE), strict=True):
        arm.asked.clear()
        assert answered(opened, f"{address.prefix}/goal") == ({f"{address.prefix}/goal"} if may_command else set())
        assert arm.commands() == (["goal"] if may_command else [])
    assert stop_all(opened, timeout=PATIENCE).answers.keys() == {HERE, THERE}
    with closing(Fleet(opened)) as fleet:

        def shown() -> bool:
            for arm in cell.arms:
                arm.state()
            fleet.ask()
            return [(it.address, it.version, it.state is not None) for it in fleet.arms()] == [
                (HERE, "9.9", True),
                (THERE, "9.9", True),
            ]

        eventually(shown, told=lambda: str(fleet.arms()))


@pytest.mark.parametrize(("who", "passes"), [("operator", ["goal", "stop"]), ("viewer", ["stop"]), ("plant", ["stop"])])
def test_puts_that_are_not_allowed_do_not_pass(cell: Cell, who: str, passes: list[str]) -> None:
    inside, outside, heard = cell.open("inside"), reached(cell, who), list[str]()
    with inside.declare_subscriber(
        "hyperbit/b/*", lambda sample: heard.append(str(sample.key_expr).rpartition("/")[2])
    ):

        def put() -> bool:
            for key in ("state", "alive", "result", "@request", "goal", "stop"):  # messages of a link keep their order
                outside.put(f"hyperbit/b/{key}", b"{}")
            return "stop" in heard

        eventually(put, every=0.05)
    assert sorted(set(heard)) == passes


def test_a_made_up_token_does_not_pass(cell: Cell) -> None:
    inside, viewer = reached(cell, "inside"), reached(cell, "viewer")
    token: Any = viewer.liveliness().declare_token("hyperbit/made-up/alive")
    assert answered(viewer, f"{HERE.prefix}/stop")  # by then the router has read the token
    assert alive(inside) == [HERE, THERE]
    token.undeclare()


def test_notes_on_requests_and_claims_stay_inside(cell: Cell) -> None:
    inside, other, viewer = reached(cell, "inside"), reached(cell, "inside"), reached(cell, "viewer")
    heard = {"inside": list[str](), "viewer": list[str]()}
    for name, opened in (("inside", other), ("viewer", viewer)):
        for key in ("@request", "feedback"):
            opened.declare_subscriber(f"hyperbit/c/{key}", lambda it, name=name: heard[name].append(str(it.key_expr)))

    def put() -> bool:
        for key in ("@request", "feedback"):
            inside.put(f"hyperbit/c/{key}", b"{}")
        return len(set(heard["inside"])) == 2 and bool(heard["viewer"])

    eventually(put, every=0.05)
    assert set(heard["viewer"]) == {"hyperbit/c/feedback"}
    claim = Claim(inside, "c")
    claim.confirm()
    with pytest.raises(AlreadyRunning, match="another daemon drives the arm 'c'"):
        Claim(other, "c").confirm()
    claim.close()


def test_without_a_certificate_nobody_connects_from_outside(cell: Cell, tmp_path: Path, keys: Path) -> None:
    stranger = certificates(tmp_path / "keys", clients=("viewer",))
    foreign = session.from_file(stranger / "viewer" / "zenoh.json5")
    foreign.insert_json5("transport/link/tls/root_ca_certificate", json.dumps(str(keys / "viewer" / "ca.pem")))
    plain = session.configuration("client")
    for config, endpoint in ((foreign, cell.outside), (plain, cell.outside.replace("tls/", "tcp/"))):
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("connect/timeout_ms", "500")
        with pytest.raises(zenoh.ZError):
            zenoh.open(config).close()


def test_states_of_the_named_arm_leave_the_cell_less_often(cell: Cell) -> None:
    sender = reached(cell, "inside")
    heard = {"inside": Counter[str](), "viewer": Counter[str]()}
    publishers = [
        sender.declare_publisher(f"hyperbit/{arm}/{key}", congestion_control=zenoh.CongestionControl.BLOCK)
        for arm, key in (("planar16", "state"), ("other", "state"), ("other", "feedback"))
    ]
    subscribers: list[Any] = [
        reached(cell, who).declare_subscriber("hyperbit/*/*", lambda it, who=who: heard[who].update([str(it.key_expr)]))
        for who in heard
    ]

    def known() -> bool:
        publishers[2].put(b"{}")
        return all(heard.values())

    eventually(known, every=0.05)
    began = time.monotonic()
    for _ in range(300):
        for publisher in publishers[:2]:
            publisher.put(b"{}")
    inside, viewer = heard["inside"], heard["viewer"]
    eventually(lambda: inside["hyperbit/planar16/state"] == viewer["hyperbit/other/state"] == 300)
    assert inside["hyperbit/other/state"] == 300
    assert 0 < viewer["hyperbit/planar16/state"] <= 10.0 * (time.monotonic() - began) + 1.0
    for subscriber in subscribers:
        subscriber.undeclare()


def test_without_a_router_the_daemons_certificates_decide_who_may_stop_all(keys: Path) -> None:
    endpoint = free_endpoint().replace("tcp/127.0.0.1", "tls/localhost")
    file = keys / "daemon" / "zenoh.json5"
    shipped = (DEPLOY / "zenoh-tls.json5").read_text()
    file.write_text(shipped.replace("/run/credentials/hyperbit@arm.service/hyperbit.", ""))
    config = session.from_file(file)
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    with ExitStack() as stack:
        PlayedArm(stack, config, "planar16")
        reports = {}
        for who, timeout in (("operator", PATIENCE), ("viewer", 0.5)):
            client = session.from_file(keys / who / "zenoh.json5")
            client.insert_json5("connect/endpoints", json.dumps([endpoint]))
            opened = stack.enter_context(zenoh.open(client))
            eventually(lambda opened=opened: alive(opened) == [HERE])
            reports[who] = stop_all(opened, timeout=timeout)
    assert reports["operator"].complete
    assert reports["viewer"] == ({}, [HERE])
