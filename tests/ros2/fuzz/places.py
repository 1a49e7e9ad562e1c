"""Puts clock, threads and network of a world in the place of the true ones."""

import contextlib
import logging
import random
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any
from unittest import mock

import zenoh.ext

from hyperbit.controller.ros2 import arm_node, bridge, goal_book, goals, jobs, poses, requests
from hyperbit.controller.ros2.arm_node import ArmNode
from hyperbit.controller.ros2.wire import action_server, services, topics
from tests.ros2.fuzz.network import Network
from tests.ros2.fuzz.stand_ins import Clock, Condition
from tests.ros2.judge.actions import Wrong

TIMED = (arm_node, bridge, goals, goal_book, poses, action_server, services, topics)


@contextlib.contextmanager
def in_place(
    chance: random.Random,
    clock: Clock,
    pool: Callable[[int, str], Any],
    let_run: Callable[[], None],
    on_words: Callable[[str], None],
) -> Iterator[None]:
    """Lets the bridge run in one thread; logged exceptions are failures.

    Args:
        let_run: runs the jobs of the threads that nothing holds up.
    """
    say = ArmNode.say

    def noted(node: ArmNode, level: int, text: str) -> None:
        if text.startswith("a request failed"):
            raise Wrong(text)
        on_words(text)
        say(node, level, text)

    def publisher(session: Network, key: str, **options: Any) -> Any:
        return session.declare_publisher(key, **options)

    def subscriber(session: Network, key: str, handler: Callable[[Any], None], **_: Any) -> Any:
        return session.declare_subscriber(key, handler)

    one_thread = SimpleNamespace(
        Condition=lambda: Condition(let_run), Lock=threading.Lock, BoundedSemaphore=threading.BoundedSemaphore
    )
    drawn = SimpleNamespace(uuid4=lambda: uuid.UUID(bytes=chance.randbytes(16)))
    with contextlib.ExitStack() as closing:
        closing.enter_context(mock.patch.object(requests, "uuid", drawn))
        for module in TIMED:
            closing.enter_context(mock.patch.object(module, "time", clock))
        closing.enter_context(mock.patch.object(jobs, "ThreadPoolExecutor", pool))
        closing.enter_context(mock.patch.object(jobs, "threading", one_thread))
        closing.enter_context(mock.patch.object(ArmNode, "say", noted))
        closing.enter_context(mock.patch.object(zenoh.ext, "declare_advanced_publisher", publisher))
        closing.enter_context(mock.patch.object(zenoh.ext, "declare_advanced_subscriber", subscriber))
        closing.enter_context(logged_exceptions())
        yield


@contextlib.contextmanager
def logged_exceptions() -> Iterator[None]:
    """Raises Wrong at the end if the bridge has logged an exception; other lines of its log are not printed."""
    found: list[str] = []

    class Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.exc_info and len(found) < 3:
                found.append(logging.Formatter().format(record))

    logger, handler = logging.getLogger("hyperbit.controller.ros2"), Handler()
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield
    except Wrong as error:
        raise Wrong("\n".join((str(error), *found))) from None
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate
    if found:
        raise Wrong("\n".join(found))


def entries(whole: object) -> int:
    """Returns the number of entries in all tables that are reached from an object of the bridge."""
    seen: set[int] = set()
    waiting, total = [whole], 0
    while waiting:
        it = waiting.pop()
        if id(it) in seen:
            continue
        seen.add(id(it))
        if isinstance(it, dict | list | set | deque | tuple):
            total += len(it)
            waiting.extend(it.values() if isinstance(it, dict) else it)
        elif type(it).__module__.startswith("hyperbit.controller.ros2") and type(it).__name__ != "Types":
            waiting.extend(vars(it).values() if hasattr(it, "__dict__") else ())
    return total
