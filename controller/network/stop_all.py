"""Stops all arms of a network, and reports which have answered."""

import itertools
import queue
import time
from typing import NamedTuple

import zenoh

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.messages.goals import Answer
from hyperbit.controller.network.fleet import PLACES, ArmAddress, address_of, alive

FIRST_WAIT, LONGEST_WAIT = 0.1, 1.0  # [s] until silent arms are asked again
ROUNDS = 2  # least number: the second round finds arms that started during the first
TIMEOUT = 5.0  # [s] until a live arm counts as silent; a daemon answers within hundredths of a second


class StopReport(NamedTuple):
    answers: dict[ArmAddress, Answer]  # an arm that accepts answers when nothing can switch any more
    silent: list[ArmAddress]  # arms that are alive and did not answer

    @property
    def complete(self) -> bool:
        """Whether at least one arm was found, and all arms have stopped."""
        return bool(self.answers) and not self.silent and all(it.accepted for it in self.answers.values())


def stop_all(session: zenoh.Session, places: tuple[str, ...] = PLACES, timeout: float = TIMEOUT) -> StopReport:
    """Stops the arms at `places`, and asks again until each arm that is alive has answered.

    The first request goes to all arms at once by wildcards, before any list of arms is read: it also reaches arms that
    this session does not know yet. A router's access control may refuse wildcards, and an arm may start meanwhile.
    Therefore each arm whose token exists, and that has not answered, is asked by its name.

    Args:
        places: key expressions of arms, such as "hyperbit/*".
        timeout: an arm without an answer after this time counts as silent [s].
    """
    replies: queue.SimpleQueue[zenoh.Reply] = queue.SimpleQueue()
    answers: dict[ArmAddress, Answer] = {}
    seen, keys, wait = set[ArmAddress](), places, FIRST_WAIT
    until = time.monotonic() + timeout
    for rounds in itertools.count(1):
        for key in keys:
            session.get(f"{key}/stop", replies.put, target=zenoh.QueryTarget.ALL, timeout=timeout)
        seen.update(alive(session, places))
        pause = min(time.monotonic() + wait, until)
        while not (seen and seen <= answers.keys()):
            try:
                note(replies.get(timeout=max(pause - time.monotonic(), 0.0)), answers)
            except queue.Empty:
                break
        silent = sorted(seen - answers.keys())
        if time.monotonic() >= until or (rounds >= ROUNDS and not silent):
            break
        keys = tuple(it.prefix for it in silent) if answers or silent else places
        wait = min(2 * wait, LONGEST_WAIT)
    return StopReport(dict(sorted(answers.items())), silent)


def note(reply: zenoh.Reply, answers: dict[ArmAddress, Answer]) -> None:
    if reply.ok is None or (address := address_of(str(reply.ok.key_expr))) is None:
        return
    try:
        answers[address] = decode(reply.ok.payload.to_bytes(), Answer)
    except Unreadable:  # it counts as none: the arm is asked again
        return
