"""Zenoh configurations from files: the shipped ones, and paths in them."""

import json
import signal
import subprocess
import sys
import time
from itertools import count
from pathlib import Path

import pytest

from hyperbit.controller.messages.goals import Result
from hyperbit.controller.network import session
from hyperbit.controller.planning.core.events import Identity, PublishResult
from tests.gateway.conftest import ARM, Gateway
from tests.keys import DEPLOY

HEAR = """
import sys, zenoh
from hyperbit.controller.network import session
from hyperbit.controller.planning.core.events import Identity, PublishResult

with zenoh.open(session.configuration("client", connect=sys.argv[1])) as it:
    it.declare_subscriber(sys.argv[2], lambda sample: print(sample.payload.to_string(), flush=True))
    print("ready", flush=True)
    for line in sys.stdin:
        print(line, end="", flush=True)
"""
STANDSTILL = 2.5  # [s], as on a busy machine
NAMES = ("root_ca_certificate", "connect_certificate", "connect_private_key")


def client_file(folder: Path, **tls: str) -> Path:
    path = folder / "zenoh.json5"
    path.write_text(json.dumps({"mode": "client", "transport": {"link": {"tls": tls}}}))
    return path


def test_relative_paths_are_beside_the_file(tmp_path: Path) -> None:
    for name in NAMES:
        (tmp_path / f"{name}.pem").touch()
    (absolute := tmp_path / "elsewhere" / "ca.pem").parent.mkdir()
    absolute.touch()
    file = client_file(tmp_path, **{name: f"{name}.pem" for name in NAMES} | {"root_ca_certificate": str(absolute)})
    tls = json.loads(session.from_file(file).get_json("transport/link/tls"))
    assert tls["root_ca_certificate"] == str(absolute)
    assert tls["connect_private_key"] == str(tmp_path / "connect_private_key.pem")
    assert tls["listen_certificate"] is None


def test_a_key_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    file = client_file(tmp_path, connect_private_key="key.pem")
    with pytest.raises(ValueError, match=r"zenoh.json5: connect_private_key: .*/key.pem: No such file or directory"):
        session.from_file(file)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    (file := tmp_path / "zenoh.json5").write_text("{ mood: 'peer' }")
    for path, why in ((file, "no Zenoh configuration"), (tmp_path / "missing.json5", "cannot be read: No such file")):
        with pytest.raises(ValueError, match=f"{path}: {why}"):
            session.from_file(path)


def test_a_fresh_install_listens_on_the_robot_alone() -> None:
    config = session.from_file(DEPLOY / "zenoh.json5")
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7447"]


@pytest.mark.parametrize("name", ["zenoh.json5", "zenoh-tls.json5", "zenoh-router.json5"])
def test_nothing_is_found_by_itself(tmp_path: Path, name: str) -> None:
    (copy := tmp_path / name).write_text((DEPLOY / name).read_text().replace("/run/credentials", str(tmp_path)))
    folder = tmp_path / ("hyperbit-router.service" if name == "zenoh-router.json5" else "hyperbit@arm.service")
    folder.mkdir()
    for file in ("ca", "certificate", "key"):
        (folder / f"hyperbit.{file}.pem").touch()
    scouting = json.loads(session.from_file(copy).get_json("scouting"))
    assert (scouting["multicast"]["enabled"], scouting["gossip"]["enabled"]) == (False, False)


def test_a_client_that_stood_still_hears_the_results_of_that_time(gateway: Gateway) -> None:
    command = [sys.executable, "-c", HEAR, gateway.endpoint, f"hyperbit/{ARM}/result"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout
        assert client.stdout.readline() == "ready\n"
        gateway.reached()
        for attempt in count():
            began = time.monotonic()
            client.send_signal(signal.SIGSTOP)
            time.sleep(STANDSTILL)
            result = Result(status="succeeded", switches=attempt)
            gateway.outbox.publish_result(PublishResult(attempt, Identity(1, attempt), False, result))
            client.send_signal(signal.SIGCONT)
            assert client.stdin
            print('{"switches": -1}', file=client.stdin, flush=True)
            heard = [json.loads(client.stdout.readline())["switches"]]
            while -1 not in heard:
                heard.append(json.loads(client.stdout.readline())["switches"])
            if time.monotonic() - began < session.LEASE / 2:  # a busy machine may make it longer than sessions last
                break
            gateway.reached()
        while attempt not in heard:
            heard.append(json.loads(client.stdout.readline())["switches"])
        client.communicate()
