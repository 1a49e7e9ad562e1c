"""One daemon for each arm: a second daemon refuses to start, and says where the first one runs.

Two daemons of one arm would both run each goal. Zenoh does not notify the owner of a liveliness token when another
session declares the same one. So a daemon looks for the token before it declares its own.
"""

import json
import time

import zenoh

from controller.gateway.session import LEASE

GRACE = 0.5  # [s] for a new session to receive the tokens of its peers
PATIENCE = LEASE + 2.0  # [s] until the token of a killed daemon, or of a lost host, disappears
ANSWER = 1.0  # [s] for the first daemon to answer where it runs
POLL = 0.1  # [s]


class AlreadyRunning(Exception):
    """Another daemon of this arm is in the network; the text says where."""


def require_no_other(session: zenoh.Session, arm: str, *, connects: bool, patience: float = PATIENCE) -> None:
    """Returns when no other daemon of the arm is in the network.

    Args:
        session: open session that has not declared the arm's token.
        arm: name of the arm.
        connects: whether the session connects to peers, whose tokens may arrive a moment later.
        patience: how long a daemon that does not answer may keep its token [s].

    Raises:
        AlreadyRunning: there is another daemon.
    """
    began = time.monotonic()
    while True:
        waited = time.monotonic() - began
        if any(reply.ok for reply in session.liveliness().get(f"hyperbit/{arm}/alive", timeout=ANSWER)):
            if (where := place(session, arm)) is not None:
                raise AlreadyRunning(f"another daemon drives the arm {arm!r}: {where}. End it, or rename this arm")
            if waited > patience:
                what = f"another daemon of the arm {arm!r} is in the network, and does not say where it runs"
                raise AlreadyRunning(f"{what}. Look for its host, end it, or rename this arm")
        elif not connects or waited > GRACE:
            return
        time.sleep(POLL)


def place(session: zenoh.Session, arm: str) -> str | None:
    """Returns where the daemon of an arm runs; None if it does not answer."""
    replies = session.get(f"hyperbit/{arm}/arm", target=zenoh.QueryTarget.ALL, timeout=ANSWER)
    for reply in replies:
        if reply.ok is not None:
            try:
                daemon = json.loads(reply.ok.payload.to_bytes())["daemon"]
                return f"process {daemon['pid']} on {daemon['host']}"
            except (ValueError, KeyError, TypeError):  # of an earlier version
                return "it is of an earlier version, which does not say where it runs"
    return None
