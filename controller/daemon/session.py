"""Zenoh sessions: no router, no scouting, explicit endpoints."""

import json
from pathlib import Path

import zenoh

ENDPOINT = "tcp/127.0.0.1:7447"


def configuration(mode: str, *, listen: str | None = None, connect: str | None = None) -> zenoh.Config:
    """Returns a configuration with the given endpoint and nothing found by itself.

    Args:
        mode: "peer" for the daemon, "client" for those who talk to it.
        listen: endpoint to accept connections at.
        connect: endpoint to connect to.
    """
    settings: dict[str, object] = {
        "mode": mode,
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "listen": {"endpoints": [listen] if listen else []},
        "connect": {"endpoints": [connect] if connect else []},
        # A peer that is frozen is given up after a second, also where a message waits for room.
        "transport": {
            "link": {
                "tx": {"lease": 1000, "queue": {"congestion_control": {"block": {"wait_before_close": 1_000_000}}}}
            }
        },
    }
    return zenoh.Config.from_json5(json.dumps(settings))


def from_file(path: Path) -> zenoh.Config:
    """Returns the configuration in a Zenoh file.

    Raises:
        ValueError: it is missing, or no Zenoh configuration.
    """
    try:
        return zenoh.Config.from_file(str(path))
    except zenoh.ZError as error:
        raise ValueError(f"{path}: no Zenoh configuration: {error}") from None
