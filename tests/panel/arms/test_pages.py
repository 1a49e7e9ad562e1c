"""Open pages: rate limits, slow pages."""

import asyncio
import json

from hyperbit.controller.panel.access.people import Person
from hyperbit.controller.panel.arms.pages import Page, RateLimit
from tests.clock import Clock


def test_an_allowance_fills_again() -> None:
    clock = Clock()
    limit = RateLimit(2.0, 3.0, clock)
    assert [limit.take_token() for _ in range(5)] == [True, True, True, False, False]
    assert limit.refused == 2
    clock.now += 1.0
    assert [limit.take_token() for _ in range(3)] == [True, True, False]


def test_a_slow_page_gets_the_latest_only() -> None:
    async def play() -> list[list[dict[str, int]]]:
        page, sent, room = Page(Person("anna", "viewer")), list[bytes](), asyncio.Event()

        async def send(data: bytes) -> None:
            sent.append(data)
            await room.wait()

        sender = asyncio.create_task(page.send_updates(send))
        page.offer("state", b'{"k": 0}')
        while not sent:
            await asyncio.sleep(0)
        for k in range(1, 1000):  # the page reads nothing
            page.offer("state", b'{"k": %d}' % k)
        room.set()
        while len(sent) < 2:
            await asyncio.sleep(0.001)
        sender.cancel()
        return [json.loads(data)[1:] for data in sent]  # without the heartbeat

    assert asyncio.run(play()) == [[{"k": 0}], [{"k": 999}]]


def test_a_page_that_reads_no_answer_is_closed() -> None:
    async def play() -> None:
        page, never = Page(Person("anna", "operator")), asyncio.Event()

        async def send(data: bytes) -> None:
            if page._closing:
                return
            never.set()

        for k in range(100):
            page.reply(b"%d" % k)
        await page.send_updates(send)  # returns

    asyncio.run(play())
