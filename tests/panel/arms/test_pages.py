"""Open pages: rate limits, slow pages, the age of commands; advice for faults; a limit of log lines."""

import asyncio
import json
import logging

from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.executor.core.modes import CLEARING
from hyperbit.controller.messages.state import Fault
from hyperbit.controller.panel.access.people import Person
from hyperbit.controller.panel.arms.faults import ACTIONS, ADVICE, COMMAND, After, advised, on_page
from hyperbit.controller.panel.arms.heartbeats import KEPT, LONGEST, Heartbeats
from hyperbit.controller.panel.arms.pages import Page, RateLimit
from hyperbit.controller.panel.log_limit import MOST_LINES, WITHIN, LogLimit
from hyperbit.controller.refusals.reasons import Reason, advice
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


@given(
    pauses=st.lists(st.floats(0.0, 3.0), min_size=1, max_size=30), waited=st.floats(0.0, 5.0), which=st.integers(0, 29)
)
def test_a_command_is_refused_if_its_heartbeat_is_older_than_allowed(
    pauses: list[float], waited: float, which: int
) -> None:
    clock = Clock()
    heartbeats, sent = Heartbeats(clock), list[tuple[int, float]]()
    for pause in pauses:
        clock.now += pause
        sent.append((heartbeats.next(), clock.now))
    clock.now += waited
    number, at = sent[which % len(sent)]
    assert (heartbeats.refusal(number) is None) == (clock.now - at <= LONGEST)


def test_the_refusal_tells_what_happened_and_what_to_do() -> None:
    clock = Clock()
    heartbeats = Heartbeats(clock)
    number = heartbeats.next()
    clock.now += 3.25
    told = heartbeats.refusal(number) or ""
    assert "3.2 s old, and may be 2 s old" in told
    assert "Nothing was sent to the arm: look at the arm, then press again" in told
    assert "reload the page" in (heartbeats.refusal(None) or "")


def test_numbers_of_other_pages_and_numbers_to_come_are_unknown() -> None:
    one, other = Heartbeats(), Heartbeats()
    number = one.next()
    assert one.refusal(number) is None
    for page, named in ((other, number), (one, number + 1), (one, 0)):
        assert "of unknown age" in (page.refusal(named) or "")


def test_old_heartbeats_take_no_memory() -> None:
    heartbeats = Heartbeats(Clock())
    numbers = [heartbeats.next() for _ in range(KEPT + 1)]
    assert heartbeats.refusal(numbers[0]) is not None
    assert [heartbeats.refusal(number) for number in numbers[1:]] == [None] * KEPT


def advices(*faults: tuple[str, str]) -> list[str]:
    return [fault["advice"] for fault in advised([Fault(code, source, "") for code, source in faults])]


def test_each_source_has_one_advice() -> None:
    assert advices(("stuck", "5.left"), ("interlock", "can0/1")) == [str(ADVICE["stuck"]), str(ADVICE["interlock"])]
    first, second = advices(("stuck", "5.left"), ("unexpected-motion", "5.left"))
    assert (first, second) == (str(ADVICE["stuck"]), "")


def test_contrary_advices_become_one_that_says_what_to_mend_and_to_reset() -> None:
    for order in (("board-rebooted", "board-lost"), ("board-lost", "board-rebooted")):
        first, second = advices(*((code, "can0/3") for code in order))
        assert first == "Check the board's supply and wires. Then hold Reset."
        assert second == ""
    assert advices(("bus-off", "can0"), ("bus-busy", "can0"))[0].endswith(After.ITSELF.value)


def test_the_faults_that_end_by_themselves_are_those_of_the_executor() -> None:
    assert {code for code, advice in ADVICE.items() if advice.after is After.ITSELF} == CLEARING


def test_a_fault_that_needs_a_reset_says_so() -> None:
    faults = advised([Fault(code, "can0/3", "") for code in ("board-rebooted", "board-lost", "degraded")])
    assert [fault["reset"] for fault in faults] == [True, False, False]


def test_an_advice_names_what_the_page_can_do() -> None:
    named = {found[1] for reason in Reason if (found := COMMAND.search(reason.advice))}
    assert named - set(ACTIONS) == {"calibrate", "run"}, "only a shell has these"
    assert on_page(advice("unknown-state", "a")) == "switch single actuators: the card Actuators"


def test_a_flood_writes_few_lines_and_hides_no_other_line() -> None:
    now, lines = [0.0], list[str]()
    limit = LogLimit(lambda: now[0])

    def say(text: str, *values: object) -> None:
        record = logging.LogRecord("panel", logging.WARNING, "", 0, text, values, None)
        if limit.filter(record):
            lines.append(record.getMessage())

    for k in range(8628):
        say("arm %s: not JSON", f"a{k}")
    say("another line")
    assert lines == [f"arm a{k}: not JSON" for k in range(MOST_LINES)] + ["another line"]
    now[0] += WITHIN
    say("arm %s: not JSON", "b")
    assert lines[-1] == f"arm b: not JSON ({8628 - MOST_LINES} such lines were dropped)"
    say("arm %s: not JSON", "c")
    assert lines[-1] == "arm c: not JSON"


def test_texts_that_differ_each_time_use_bounded_memory() -> None:
    limit = LogLimit()
    for k in range(3000):
        limit.filter(logging.LogRecord("panel", logging.WARNING, "", 0, f"text {k}", (), None))
    assert len(limit.kinds) <= 1000
