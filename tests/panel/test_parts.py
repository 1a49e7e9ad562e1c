"""Single parts of the panel: tokens, rate limits, slow pages, drawings, advice."""

import asyncio
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from controller.arm.arm import load
from controller.arm.description import density, description, drawing
from controller.armfile.strict import InputFaults
from controller.commands.operate.run import reachable, run
from controller.panel.access import Access
from controller.panel.drawing import Drawing, cloud, picture
from controller.panel.pages import Page, RateLimit
from controller.panel.people import Person, PersonEntry, digest_of, read_people
from controller.panel.serve import parse_address, serve, zenoh_configuration
from controller.panel.sessions import MOST_OF_PERSON
from controller.panel.wrong_tokens import FIRST_DELAY, FREE, LONGEST_DELAY, WrongTokens
from controller.workspace.mapping import map_densities
from tests.keys import DEPLOY

ANNA = PersonEntry("anna", "operator", digest_of("a"))


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_sessions_end(tmp_path: Path) -> None:
    clock, file = Clock(), tmp_path / "sessions.json"
    access = Access([ANNA], file, clock)
    first, second = access.enter("a"), access.enter("a")
    assert first is not None
    assert first != second
    assert access.person(first) == access.person(second) == Person("anna", "operator")
    for forged in (None, "", "anna", first + "x", first[:-1], "\ud800"):
        assert access.person(forged) is None
    assert first not in file.read_text()
    access.leave(first)
    restarted = Access([ANNA], file, clock)
    assert restarted.person(first) is None, "logged out, also after a restart"
    assert restarted.person(second) is not None
    assert Access([PersonEntry("anna", "viewer", ANNA.token)], file, clock).person(second) is None, "another role"
    assert Access([PersonEntry("anna", "operator", digest_of("b"))], file, clock).person(second) is None
    assert Access([PersonEntry("bert", "operator", ANNA.token)], file, clock).person(second) is None
    clock.now += 13 * 3600
    assert restarted.person(second) is None
    file.write_text("{")
    assert Access([ANNA], file, clock).person(second) is None


def test_a_person_has_few_sessions() -> None:
    access = Access([ANNA, PersonEntry("bert", "viewer", digest_of("b"))])
    other, cookies = access.enter("b"), [access.enter("a") for _ in range(MOST_OF_PERSON + 1)]
    assert [access.person(cookie) is None for cookie in cookies] == [True] + [False] * MOST_OF_PERSON
    assert access.person(other) is not None


def test_tokens_are_not_guessed() -> None:
    access = Access([ANNA, PersonEntry("carl", "operator")])
    assert [access.enter(token) for token in ("", "b", "aa", "None")] == [None] * 4
    assert access.bearer("a") == Person("anna", "operator")
    assert access.certified("carl") == Person("carl", "operator")
    assert access.certified(None) is None


def test_wrong_tokens_delay_the_answers_to_their_address() -> None:
    clock = Clock()
    wrong = WrongTokens(clock)
    delays = [wrong.delay("a") for _ in range(1000)]
    assert delays[:6] == [0.0] * FREE + [FIRST_DELAY, 2 * FIRST_DELAY, 4 * FIRST_DELAY]
    assert delays[-1] == LONGEST_DELAY
    assert wrong.delay("b") == 0.0
    clock.now += 61
    assert wrong.delay("a") == 0.0


def test_the_file_of_people_is_read_strictly(tmp_path: Path) -> None:
    path = tmp_path / "people.yaml"
    path.write_text(f"people: [{{name: anna, role: operator, token: {digest_of('a')}}}, {{name: carl, role: viewer}}]")
    assert read_people(path) == [ANNA, PersonEntry("carl", "viewer")]
    for text, fault in (
        ("people: []", "people"),
        ("people: [{name: anna, role: king}]", "people[0].role"),
        ("people: [{name: 'a.b', role: viewer}]", "people[0].name"),
        ("people: [{name: a, role: viewer, token: secret}]", "people[0].token"),
        ("people: [{name: a, role: viewer}, {name: a, role: operator}]", "a is listed twice"),
    ):
        path.write_text(text)
        with pytest.raises(InputFaults, match=re.escape(fault)):
            read_people(path)


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
        return [json.loads(data) for data in sent]

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


@pytest.mark.parametrize("name", ["planar16", "platform8", "motor12"])
def test_arms_are_drawn_as_the_daemon_knows_them(name: str) -> None:
    arm = load(DEPLOY / f"{name}.yaml")
    m = arm.manipulator
    drawn = Drawing(json.loads(json.dumps({**description(arm), "drawing": drawing(arm)})))
    rng = np.random.default_rng(1)
    configuration = rng.integers(0, m.states)
    wanted = m.body(configuration)[:, :, : m.dimension].ravel()
    states = m.actuator_states(configuration).tolist()
    np.testing.assert_allclose(drawn.of_actuators(states), wanted, atol=1e-4 * m.length)
    assert sum(drawn.lines) == len(m.body(configuration))
    text = drawn.of_text(",".join(map(str, configuration)) if m.states.max() > 10 else "".join(map(str, configuration)))
    assert text == drawn.of_actuators(states)
    assert drawn.of_text("9" * 3) is None
    assert drawn.of_actuators([None] * len(states)) is None
    assert drawn.of_actuators([None] * len(states), states) == text


def test_densities_are_pictures_in_the_plane_and_clouds_in_space() -> None:
    arm = load(DEPLOY / "planar16.yaml")
    told = density(map_densities(arm.manipulator, arm.manipulator.length / 40, 10_000), planar=True)
    pixels = imread(io.BytesIO(picture(told)), format="png")
    assert pixels.shape[:2] == tuple(told["shape"][1:])
    opacity = pixels[..., -1]
    assert opacity.min() == 0.0
    assert 0.4 < opacity.max() < 0.8
    arm = load(DEPLOY / "platform8.yaml")
    densities = map_densities(arm.manipulator, arm.manipulator.length / 40, 10_000)
    points = np.array(cloud(density(densities, planar=False)))
    assert 100 < len(points) <= 4000
    low, high = densities.box(0)
    assert (points[:, :3] >= low - 1e-3).all()
    assert (points[:, :3] <= high + 1e-3).all()


@pytest.mark.parametrize("text", ["", "7480", ":7480", "localhost", "localhost:x", "localhost:70000", "a:²"])
def test_addresses_are_read_strictly(text: str) -> None:
    with pytest.raises(InputFaults, match="HOST:PORT"):
        parse_address(text)


@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "192.168.1.2", "robot.local"])
def test_other_computers_need_tls(host: str) -> None:
    address = parse_address(f"{host}:7480")
    assert not address.local
    with pytest.raises(InputFaults, match="TLS is needed"):
        serve(address, None, None, zenoh_configuration(["tcp/127.0.0.1:1"], None), "hyperbit")


def test_addresses_of_this_computer() -> None:
    for text in ("127.0.0.1:1", "localhost:2", "[::1]:3", "127.1.2.3:4"):
        assert parse_address(text).local
    assert parse_address("[::1]:3").written(3, secure=True) == "https://[::1]:3/"


def test_run_gives_the_page_its_endpoint(tmp_path: Path) -> None:
    assert reachable("tcp/0.0.0.0:7447") == reachable("tcp/[::]:7447") == "tcp/127.0.0.1:7447"
    assert reachable("tcp/192.168.1.2:7448") == "tcp/192.168.1.2:7448"
    with pytest.raises(InputFaults, match="start the page separately"):
        run(tmp_path / "arm.yaml", zenoh_file=tmp_path / "zenoh.json5", panel=7480)
