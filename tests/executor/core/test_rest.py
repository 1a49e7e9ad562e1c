"""At rest the loop waits until something is due. A commit ends rest at once. Snapshots keep their rate."""

from hyperbit.controller.executor.core.core import REST
from hyperbit.controller.program import TICK, Ended
from tests.executor.rig import B, ready_world


def test_at_rest_few_ticks_come_and_in_motion_one_a_period() -> None:
    world, resting, moving = ready_world(), list[int](), set[int]()
    world.go(1.0, lambda: resting.append(round(world.core.period / TICK)))
    assert set(resting) <= set(range(1, REST + 1))
    assert sum(resting) / len(resting) > 3, "nothing is due in most periods"
    shown = len(world.of(type(world.snapshot)))
    world.go(1.0)
    assert 19 <= len(world.of(type(world.snapshot))) - shown <= 21, "20 snapshots a second"
    world.run(B)
    world.go(TICK)
    while world.mode == "executing":
        world.go(TICK)
        moving.add(round(world.core.period / TICK))
    assert moving == {1}, "each period has its tick"
    assert world.last(Ended).status == "done"
