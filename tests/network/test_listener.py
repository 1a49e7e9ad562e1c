"""What a listener hears over Zenoh: all keys of its arm, requests by name, and when the daemon comes and goes."""

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from hyperbit.controller.network import listener as listening
from hyperbit.controller.network import session
from hyperbit.controller.network.listener import Listener, ReceivedMessage
from tests.waiting import eventually

ARM = json.dumps({"name": "a"}).encode()


@pytest.fixture
def ends(tmp_path: Path) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    endpoint = f"unixsock-stream/{tmp_path}/z.sock"
    with ExitStack() as stack:
        daemon = stack.enter_context(zenoh.open(session.configuration("peer", listen=endpoint)))
        yield daemon, stack.enter_context(zenoh.open(session.configuration("client", connect=endpoint)))


def until(listener: Listener, key: str, before: list[ReceivedMessage]) -> ReceivedMessage:
    """The next message on a key; those before it are put to `before`."""

    def found() -> ReceivedMessage | None:
        before.extend(listener.receive_messages(0.1))
        return next((it for it in before if it.key == key), None)

    item = eventually(found)
    before.remove(item)
    return item


def test_all_messages_of_the_arm_are_received(ends: tuple[zenoh.Session, zenoh.Session]) -> None:
    daemon, own = ends
    listener, items = Listener(own, "a"), list[ReceivedMessage]()
    publisher = daemon.declare_publisher("hyperbit/a/@request")
    eventually(lambda: publisher.matching_status.matching)
    daemon.put("hyperbit/a/state", b"1")
    daemon.put("hyperbit/b/state", b"of another arm")
    daemon.put("hyperbit/a/some/key", b"2")
    daemon.put("hyperbit/a/arm", b"forged")
    daemon.put("hyperbit/a/gone", b"forged")
    daemon.put("hyperbit/a/request", b"forged")
    publisher.put(b"3")
    assert until(listener, "request", items).data == b"3"
    assert until(listener, "state", items).data == b"1"
    assert until(listener, "some/key", items).data == b"2"
    assert items == []
    listener.close()


def test_the_daemon_is_heard_to_come_and_go_and_describes_the_arm(ends: tuple[zenoh.Session, zenoh.Session]) -> None:
    daemon, own = ends
    asked: list[bytes] = []

    def answer(query: zenoh.Query) -> None:
        asked.append(query.payload.to_bytes() if query.payload else b"")
        with query:
            query.reply("hyperbit/a/arm", ARM)

    queryable = daemon.declare_queryable("hyperbit/a/arm", answer)
    token = daemon.liveliness().declare_token("hyperbit/a/alive")
    listener, items = Listener(own, "a"), list[ReceivedMessage]()
    until(listener, "alive", items)

    def described() -> bool:
        listener.ask()  # a get may come before the routes are known
        items.extend(listener.receive_messages(0.2))
        return any(it == ReceivedMessage(it.at, "arm", ARM) for it in items)

    eventually(described)
    assert json.loads(asked[0]) == {"with": ["drawing", "file"]}
    token.undeclare()
    until(listener, "gone", items)
    token = daemon.liveliness().declare_token("hyperbit/a/alive")
    until(listener, "alive", items)
    listener.close()
    token.undeclare()
    queryable.undeclare()


def test_a_stranger_who_answers_hides_no_description(ends: tuple[zenoh.Session, zenoh.Session]) -> None:
    """Without a target for all, Zenoh asks only the complete queryable."""
    daemon, own = ends
    queryables = [
        daemon.declare_queryable(key, lambda query, data=data: query.reply("hyperbit/a/arm", data), complete=complete)
        for key, data, complete in (("hyperbit/a/arm", ARM, False), ("hyperbit/a/*", b"forged", True))
    ]
    listener, items = Listener(own, "a"), list[ReceivedMessage]()

    def described() -> bool:
        listener.ask()
        items.extend(listener.receive_messages(0.2))
        return {it.data for it in items} == {ARM, b"forged"}

    eventually(described)
    listener.close()
    for queryable in queryables:
        queryable.undeclare()  # type: ignore[no-untyped-call]


def test_what_nobody_writes_does_not_fill_the_memory(
    ends: tuple[zenoh.Session, zenoh.Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listening, "MOST_WAITING", 100)
    listener = Listener(ends[1], "a")
    for _ in range(30):
        listener.put("state", bytes(10))
    assert (len(listener.receive_messages(0.0)), listener.dropped(), listener.dropped()) == (10, 20, 0)
    listener.put("state", bytes(10))
    assert len(listener.receive_messages(0.0)) == 1
    listener.close()
