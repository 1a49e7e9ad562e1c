"""No frame and no event raises an exception or moves an actuator."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.drivers.canopen.faults import Busy
from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, FrameEchoed, FrameIgnored, FrameReceived, SendFailed
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from tests.drivers.rig import World, measured, two_boards, two_buses

NODES = (5, 9)
OURS = [base + node for base in (0x080, 0x180, 0x200, 0x580, 0x600, 0x700) for node in NODES]
COB_IDS = st.sampled_from([*OURS, 0x000, 0x080, 0x77F, 0x7E4]) | st.integers(0, 0x7FF)
ANSWERS = st.builds(
    lambda node, kind, index, sub, rest: Frame(0x580 + node, bytes((kind, index & 0xFF, index >> 8, sub)) + rest),
    st.sampled_from(NODES),
    st.sampled_from([0x00, 0x01, 0x10, 0x40, 0x41, 0x42, 0x43, 0x4F, 0x60, 0x80]) | st.integers(0, 255),
    st.sampled_from([0x1000, 0x1017, 0x1800, 0x6200, 0x6206, 0x1016, 0x1400, 0x6000]),
    st.integers(0, 5),
    st.binary(min_size=4, max_size=4),
)
FRAMES = st.builds(Frame, COB_IDS, st.binary(max_size=8)) | ANSWERS
STATES = st.sampled_from(["active", "warning", "passive", "bus-off", "down", "closed", None])
ERRORS = st.none() | st.tuples(st.integers(0, 255), st.integers(0, 255))
EVENTS = (
    st.builds(FrameReceived, st.just("can0"), FRAMES)
    | st.builds(FrameEchoed, st.just("can0"), FRAMES)
    | st.builds(FrameIgnored, st.just("can0"), st.integers(0, 200))
    | st.builds(SendFailed, st.just("can0"), FRAMES, st.just("full"))
    | st.builds(BusChanged, st.just("can0"), STATES, st.text(max_size=5), ERRORS)
)


@settings(max_examples=25, deadline=None)
@given(frames=st.lists(FRAMES, max_size=30))
def test_no_frame_makes_a_ready_master_raise_or_move(frames):
    world = World(two_boards()).up()
    for frame in frames:
        world.master.receive_event(FrameReceived("can0", frame, None), world.now)  # the boards do not hear it
        world.master.status()
    world.run(0.05)
    assert not [frame for frame in world.frames() if frame[0] in (0x000, 0x080, 0x205, 0x209)]
    assert world.switches() == [0, 0]
    world.run(0.3)
    world.up()
    world.commit(1, 0, then=0.1)
    assert world.measured() == [1, 0]


SYSTEM = (
    st.tuples(st.sampled_from(["boot", "commit", "question", "probe", "tick", "stall"]), st.integers(0, 3)) | EVENTS
)


@settings(max_examples=50, deadline=None)
@given(steps=st.lists(SYSTEM, max_size=60), shared=st.booleans())
def test_no_event_and_no_command_raises_and_no_sync_is_sent_unasked(steps, shared):
    sent: list[Frame] = []
    buses = (BusWiring("can0", "none", ""),)
    wiring = Wiring(buses, tuple(two_boards()), shared_rpdo=shared)
    master = Master(wiring, Timing(), lambda bus, frame: sent.append(frame))
    now, commits = 0.0, 0
    for step in steps:
        now += 0.001
        if not isinstance(step[0], str) or step[0] == "can0":
            master.receive_event(step, now)
        elif step[0] == "commit":
            try:
                master.commit(step[1], now)
                commits += 1
            except Busy:
                pass
        elif step[0] == "boot":
            master.boot(now)
        elif step[0] == "question":
            master.question(step[1] % 2, now)
        elif step[0] == "probe":
            master.probe_silent(now)
        else:
            now += 0.01 if step[0] == "tick" else 0.5
            master.tick(now)
        assert 0 <= measured(master, wiring) <= 3
        assert master.known in (0, 1, 2, 3)
        master.status(), master.warnings(), master.back, master.boot_faults, master.drain_faults()
    assert sum(frame.id == 0x080 for frame in sent) <= commits
    if not commits:
        assert not [frame for frame in sent if frame.id in (0x205, 0x209)]


VALUES = st.sampled_from([0, 1, 2, 8, 64, 255, 0x80, 0x85, 0x205, 0x185, 0x80000205, 0x62000108, 0x60000108, 0x191])
ANSWER = st.one_of(
    st.tuples(st.just("value"), VALUES | st.integers(0, 2**32 - 1), st.integers(1, 4)),
    st.tuples(st.just("value"), VALUES, st.just(4)),
    st.tuples(st.just("abort"), st.sampled_from([0x06020000, 0x06090011, 0x06010002, 0x06090030, 0]), st.just(0)),
    st.tuples(st.just("segments"), st.integers(0, 2**32 - 1), st.integers(0, 7)),
    st.tuples(st.just("silence"), st.just(0), st.just(0)),
)
RIGHT = {0x1000: 0x00030191, 0x6200: 8, 0x6000: 8, 0x1005: 0x80}


@settings(max_examples=50, deadline=None)
@given(
    answers=st.lists(st.none() | ANSWER, max_size=60),
    on_loss=st.sampled_from(["hold", "contract"]),
    shared=st.booleans(),
    beats=st.booleans(),
    many=st.booleans(),
)
def test_a_board_may_answer_anything_while_it_is_booted(answers, on_loss, shared, beats, many):
    """None is a correct answer, after which the boot continues. The boot ends with success or a fault."""
    channels = [Channel("a", "can0", 5, 0, 0), Channel("b", "can0", 5, 130 if many else 1, 1)]
    wiring = Wiring((BusWiring("can0", "none", ""),), tuple(channels), on_loss=on_loss, shared_rpdo=shared)
    sent: list[Frame] = []
    master = Master(wiring, Timing(boot_timeout=0.2), lambda bus, frame: sent.append(frame))
    master.receive_event(BusChanged("can0", "active", "", None), 0.0)
    master.tick(0.0)
    master.boot(0.0)
    now, written, script = 0.0, dict[bytes, bytes](), iter(answers)
    while master.booting:
        now += 0.01
        assert now < 600
        master.tick(now)
        if beats:
            master.receive_event(FrameReceived("can0", Frame(0x705, b"\x05"), None), now)
        while sent:
            frame = sent.pop(0)
            master.receive_event(FrameEchoed("can0", frame, None), now)
            if frame.id != 0x605 or frame.data[0] == 0x80:
                continue
            place, reading = frame.data[1:4], frame.data[0] == 0x40
            answer = next(script, None)
            if answer is None and not reading:
                written[place] = frame.data[4:]
                data = b"\x60" + place + bytes(4)
            elif answer is None:
                value = RIGHT.get(int.from_bytes(place[:2], "little"), 0).to_bytes(4, "little")
                data = b"\x43" + place + written.get(place, value)
            elif answer[0] == "silence":
                continue
            elif answer[0] == "abort":
                data = b"\x80" + place + answer[1].to_bytes(4, "little")
            elif answer[0] == "segments":
                data = bytes((answer[2] << 1,)) + bytes(7)
            else:
                kind = 0x43 | (4 - answer[2]) << 2 if reading else 0x60
                data = bytes((kind,)) + place + answer[1].to_bytes(4, "little")
            master.receive_event(FrameReceived("can0", Frame(0x585, data), None), now)
    assert master.outputs_known or master.boot_faults
    assert all(fault.message for fault in master.boot_faults)


FAULTS = st.sampled_from(
    ["hold", "release", "full", "room", "bus-off", "active", "down", "cut", "silent", "heard", "stall", "lose", "find"]
)
STEPS = st.lists(
    st.tuples(FAULTS | st.sampled_from(["commit", "commit", "boot", "wait"]), st.integers(0, 3)), max_size=25
)


@settings(max_examples=20, deadline=None)
@given(steps=STEPS, on_loss=st.sampled_from(["hold", "contract"]))
def test_outputs_change_only_by_commits_whatever_fails(steps, on_loss):
    world = World(two_buses(), Timing(boot_timeout=0.5), on_loss=on_loss).up()
    boards = [world.boards.board(name) for name in ("can0/5", "can1/5")]
    bus = world.buses["can1"]

    def driven() -> list[int]:
        return [board.objects.number(0x6200, 1) for board in boards]

    states = [0, 0]
    for what, number in steps:
        if what == "commit":
            before = driven()
            try:
                world.master.commit(number, world.now)
                states = [number & 1, number >> 1]
            except Busy:
                assert driven() == before
        elif what == "boot":
            world.master.boot(world.now)
        elif what in ("hold", "release"):
            bus.stuck = what == "hold"
            bus.begin()
        elif what in ("full", "room"):
            bus.room = 0 if what == "full" else None
        elif what in ("bus-off", "active", "down"):
            {"bus-off": bus.go_off, "active": bus.restore, "down": bus.go_down}[what]()
        elif what in ("silent", "heard"):
            boards[number % 2].silent = what == "silent"
        elif what == "cut":
            world.fault("power_cut", f"can{number % 2}/5")
            world.fault("power_on", f"can{number % 2}/5")
        elif what in ("lose", "find"):
            world.lost = lambda bus, frame, lost=what == "lose": lost and frame.id & 0x780 == 0x180
        elif what == "stall":
            world.stall(0.15 * number)
        before = driven()
        world.run(0.03 * number)
        for k, state in enumerate(driven()):  # what was asked for last, or contracted by a cut or a lost master
            assert state in (before[k], states[k], 0)
    bus.stuck, bus.room = False, None
    bus.begin()
    for board in boards:
        board.silent = False
    world.lost = lambda bus, frame: False
    world.buses["can1"].restore()
    world.run(2)
    world.up()
    world.commit_when_possible(1, 1)
    world.run(0.2)
    assert world.measured() == [1, 1]
    assert driven() == [1, 1]
