"""Sessions with certificates, sessions of strangers, and the requests that reach a planner."""

import json
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client
from hyperbit.controller.planning.core.events import Key, Message, SetpointArrived, TipArrived
from hyperbit.controller.planning.loop import Mailbox
from hyperbit.controller.planning.planner import RequestDecoder
from tests.keys import certificates, openssl
from tests.system.stack.observer import Observer
from tests.system.stack.system import System

PREFIX = "hyperbit/planar16"
AT_ONCE = 0.5  # [s] in which an unwanted answer would arrive


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
