"""What a stranger sends on an arm's keys takes no stop from the daemon."""

import pytest

from tests.gateway.conftest import ARM, Gateway
from tests.gateway.test_server import asked
from tests.strangers import KEYS, PAYLOADS, intrude


@pytest.mark.parametrize("key", KEYS)
def test_no_message_takes_the_stop_away(gateway: Gateway, key: str) -> None:
    stranger = gateway.other()
    intrude(stranger, f"hyperbit/{ARM}", [key])
    for payload in PAYLOADS:
        asked(stranger, f"hyperbit/{ARM}/{key}", payload)  # type: ignore[arg-type]
    client = gateway.client()
    assert client.request("stop")["accepted"]
    assert gateway.planner.keys()[-1] == "stop"
    assert client.alive()
