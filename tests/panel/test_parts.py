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
from controller.panel.access import Access, Person, PersonEntry, TooManyWrong, digest_of, read_people
from controller.panel.drawing import Drawing, cloud, picture
from controller.panel.pages import Page, RateLimit
from controller.panel.serve import parse_address, serve, zenoh_configuration
from controller.workspace.mapping import map_densities
from tests.keys import DEPLOY

ANNA = PersonEntry("anna", "operator", digest_of("a"))


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_old_and_changed_cookies_are_invalid() -> None:
    clock = Clock()
    access = Access([ANNA], b"key", clock)
    cookie = access.enter("a")
    assert cookie is not None
    assert access.person(cookie) == Person("anna", "operator")
    name, until, signature = cookie.split(".")
    for forged in (f"bert.{until}.{signature}", f"{name}.{int(until) + 1}.{signature}", f"{name}.{until}.{'0' * 64}"):
        assert access.person(forged) is None
    assert Access([PersonEntry("anna", "viewer", ANNA.token)], b"key", clock).person(cookie) is None, "another role"
    other_token = PersonEntry("anna", "operator", digest_of("b"))
    assert Access([other_token], b"key", clock).person(cookie) is None, "another token"
    assert Access([ANNA], b"another", clock).person(cookie) is None
    clock.now += 13 * 3600
    assert access.person(cookie) is None


def test_tokens_are_not_guessed() -> None:
    clock = Clock()
    access = Access([ANNA, PersonEntry("carl", "operator")], b"key", clock)
    for guess in range(10):
        assert access.enter(str(guess)) is None
    with pytest.raises(TooManyWrong):
        access.enter("a")
    clock.now += 61
    assert access.enter("a") is not None
    assert access.certified("carl") == Person("carl", "operator")
    assert access.certified(None) is None


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
        run(tmp_path / "arm.yaml", zenoh_file=tmp_path / "zenoh.json5", panel=True)
