"""The period of the master's heartbeat."""

from random import Random
from types import SimpleNamespace

import pytest

from hyperbit.drivers.canopen.run.heartbeat import Heartbeat
from hyperbit.drivers.canopen.wiring import Timing


@pytest.mark.parametrize("lateness", [0.0, 0.0003, 0.005])
def test_late_ticks_do_not_add_up(lateness: float) -> None:
    sent, draw, timing = [], Random(1), Timing()

    def send_frame(frame: object, now: float) -> None:
        sent.append(now)

    link = SimpleNamespace(
        name="can0", usable=True, failing=False, misses_echo=lambda now, beat: False, send_frame=send_frame
    )
    heartbeat = Heartbeat([link], [], timing)
    for k in range(10_000):
        clock = 0.01 * k + draw.uniform(0.0, lateness)
        heartbeat.tick(clock, clock)
    assert (sent[-1] - sent[1]) / (len(sent) - 2) == pytest.approx(timing.heartbeat, rel=0.01)
