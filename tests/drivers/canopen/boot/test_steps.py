"""Single steps of a board's boot: what is written and ordered, and in which words it fails."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.wiring import Timing
from hyperbit.drivers.simulation.dictionary import Changes, array
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS
from tests.drivers.rig import TICK, World, one_board

PRE_OPERATIONAL = (0, "80 05")


def changed(changes: Changes, **more: object) -> World:
    return World(one_board(), variants={"can0/5": replace(STANDARD, changes=changes, **more)})


def refusal(world: World) -> tuple[str, str]:
    [fault] = world.boot()
    return fault.code, fault.message


def test_another_cob_id_that_cannot_be_written_is_refused():
    world = changed({}, read_only=frozenset({0x1400}))
    world.boards.board("can0/5").objects.set_number(0x1400, 1, 0x555)
    code, text = refusal(world)
    assert (code, text.split(";")[0]) == (
        "sdo-refused",
        "board can0/5: RPDO1 has the COB-ID 00000555h in 1400h sub 1, not 205h",
    )


@pytest.mark.parametrize(("others", "entry"), [([], 1), ([16], 2), ([16, 17], 3), ([16, 17, 18], 1)])
def test_the_master_is_watched_in_the_first_free_entry(others, entry):
    entries = [node << 16 | 500 for node in others] + [0] * (3 - len(others))
    world = changed(array(0x1016, entries, size=4)).up()
    objects = world.boards.board("can0/5").objects
    assert [sub for sub in (1, 2, 3) if objects.number(0x1016, sub) >> 16 == 127] == [entry]


def test_a_guarded_board_that_does_not_tell_its_state_is_made_to_before_it_is_ordered_anything():
    world = World(variants={"can0/5": VARIANTS["guarding-with-1029h"]}, on_loss="contract").up()
    world.run(0.3)
    world.timing = Timing(heartbeat=0.05, heartbeat_timeout=0.35)
    world.new_master()
    world.boot()
    sent = [frame for frame in world.frames(sdo=True) if frame[0] in (0, 0x605)]
    before = sent[: sent.index(PRE_OPERATIONAL)]
    assert [data for _, data in before if data.startswith("2")] == [
        "2b 0c 10 00 32 00 00 00",
        "2f 0d 10 00 07 00 00 00",
        "2f 06 62 01 fc 00 00 00",
    ], "the guard time, the life time factor, and outputs that hold"
    assert world.master.boot_faults == []


@pytest.mark.parametrize(("on_loss", "early"), [("hold", True), ("contract", False)])
def test_outputs_that_go_off_without_the_master_are_set_to_it_after_the_start_only(on_loss, early):
    world = World(on_loss="hold" if on_loss == "contract" else "contract").up()
    world.wiring = replace(world.wiring, on_loss=on_loss)
    world.new_master()
    world.boot()
    sent = [data for cob_id, data in world.frames(sdo=True) if cob_id in (0, 0x605)]
    written = [k for k, data in enumerate(sent) if data.startswith("2f 06 62 01")]
    assert (written[-1] < sent.index("01 05")) is early
    assert len(written) == 1


def test_the_boot_goes_on_with_the_echo_of_an_order():
    world = World().up()
    world.run(0.2)
    world.timing = Timing(heartbeat=0.03)
    world.new_master()
    world.master.boot(world.now)
    world.until(lambda: PRE_OPERATIONAL in world.frames(sdo=True))
    took = world.until(lambda: any(cob_id == 0x605 for cob_id, _ in world.frames(sdo=True)))
    assert took < TICK / 10
