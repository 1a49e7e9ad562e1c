"""Zenoh sessions: no router, no scouting, explicit endpoints."""

import json
from collections.abc import Callable
from pathlib import Path

import zenoh

from hyperbit.controller.host.files import open_file
from hyperbit.controller.network.endpoints import parse_endpoint

LEASE = 10.0  # [s] of silence after which a peer counts as lost; long, because busy machines stand still for seconds
MOST_BLOCKED = 1.0  # [s] that a message waits for a peer that does not read, before the peer is disconnected
SHARED_MEMORY = {"enabled": False}  # Zenoh opens no session when other programs have filled /dev/shm
TLS = "transport/link/tls"
TLS_FILES = (
    *("root_ca_certificate", "listen_certificate", "listen_private_key"),
    *("connect_certificate", "connect_private_key"),
)


def configuration(mode: str, *, listen: str | None = None, connect: str | None = None) -> zenoh.Config:
    """Returns a configuration with the given endpoints and without scouting.

    Args:
        mode: "peer" for the daemon, "client" for its clients.
        listen: endpoint to accept connections at.
        connect: endpoint to connect to.

    Raises:
        ValueError: an endpoint is none.
    """
    for endpoint in filter(None, (listen, connect)):
        parse_endpoint(endpoint)
    settings: dict[str, object] = {
        "mode": mode,
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "listen": {"endpoints": [listen] if listen else []},
        "connect": {"endpoints": [connect] if connect else []},
        "transport": {
            "shared_memory": SHARED_MEMORY,
            "link": {
                "tx": {
                    "lease": round(LEASE * 1e3),
                    "queue": {"congestion_control": {"block": {"wait_before_close": round(MOST_BLOCKED * 1e6)}}},
                }
            },
        },
    }
    return zenoh.Config.from_json5(json.dumps(settings))


def from_file(path: Path) -> zenoh.Config:
    """Returns the configuration in a Zenoh file; relative paths of certificates and keys start at the file's folder.

    Raises ValueError if the file, a certificate or a key cannot be read, or is no Zenoh configuration.
    """
    try:
        open_file(path).close()  # Zenoh itself would read a device, or a pipe, without an end
        config = zenoh.Config.from_file(str(path))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    except zenoh.ZError as error:
        raise ValueError(f"{path}: no Zenoh configuration: {reason(error)}") from None
    config.insert_json5("transport/shared_memory", json.dumps(SHARED_MEMORY))
    for name, value in json.loads(config.get_json(TLS)).items():
        if name in TLS_FILES and value is not None:
            file = path.parent / value
            try:
                open_file(file).close()
            except OSError as error:
                raise ValueError(f"{path}: {name}: {file}: {error.strerror}") from None
            config.insert_json5(f"{TLS}/{name}", json.dumps(str(file.absolute())))
    return config


def lease(config: zenoh.Config) -> float:
    """Returns the lease of a configuration's session [s]."""
    return float(json.loads(config.get_json("transport/link/tx/lease"))) / 1e3


def reachable(session: zenoh.Session, config: zenoh.Config) -> Callable[[], bool]:
    """Returns a function that tests whether a session is connected to one of its endpoints, if it has any."""
    endpoints = json.loads(config.get_json("connect/endpoints"))
    return lambda: not endpoints or bool(session.info.routers_zid() or session.info.peers_zid())


def reason(error: zenoh.ZError) -> str:
    """Returns the message of a Zenoh error, without the places in Zenoh's source and its notation of endpoints."""
    return str(error).split(" at /")[0].split(" to any of [")[0].strip()
