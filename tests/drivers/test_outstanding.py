"""What was sent is known again whenever it comes back."""

import can

from drivers import outstanding
from drivers.outstanding import Outstanding

HEARTBEAT = can.Message(arbitration_id=0x77F, data=[5], is_extended_id=False, is_rx=False)


def test_the_first_frame_is_ours_however_late_it_comes_back(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(outstanding.time, "monotonic", lambda: now[0])
    sent = Outstanding()
    for _ in range(3):
        with sent.sending(HEARTBEAT):
            now[0] += 0.7
    assert [sent.came_back(HEARTBEAT) for _ in range(4)] == [True, True, True, False]
