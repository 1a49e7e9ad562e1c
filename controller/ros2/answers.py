"""Requests of the bridge to the daemon, and their answers."""

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from hyperbit.controller.decoding.decoding import Unreadable, convert
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import Answer
from hyperbit.controller.messages.reading import ANSWERS
from hyperbit.controller.network.client import Client, Unanswered

TIMEOUT = 10.0  # [s] for an answer of the daemon

Sending = Callable[[], contextlib.AbstractContextManager[None]]


def request(
    client: Client,
    key: str,
    payload: Mapping[str, Any] | None = None,
    sending: Sending = contextlib.nullcontext,
    timeout: float = TIMEOUT,
) -> Answer:
    """Sends a request to the daemon and returns its answer: a `Plan` or `LedgerAnswer` if it has one.

    Raises Unanswered if no answer that can be read came within `timeout` [s]. `sending` is entered while the request is
    sent.
    """
    try:
        told = client.request(key, payload, timeout, sending)
        answer = convert(told, Answer)
        return convert(told, ANSWERS[key]) if answer.accepted and key in ANSWERS else answer
    except (Unreadable, zenoh.ZError) as error:
        raise Unanswered(f"the answer to {key} cannot be read: {error}") from None


def described(client: Client) -> Description:
    """Returns the daemon's description of its arm. Raises Unanswered as `request` does."""
    try:
        return convert(client.request("arm", {}, TIMEOUT, contextlib.nullcontext), Description)
    except (Unreadable, zenoh.ZError) as error:
        raise Unanswered(f"the answer to arm cannot be read: {error}") from None


def sentence(answer: Answer) -> str:
    """Returns the message of an answer, with the reason of a refusal."""
    return f"{answer.message} ({answer.reason})" if answer.reason else answer.message
