"""Log lines for Foxglove about modes, faults, requests and results."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

Message = Mapping[str, Any]

INFO, WARNING, ERROR = 2, 3, 4  # levels of foxglove.Log


class LogLine(NamedTuple):
    """A line of the log, with a level of foxglove.Log."""

    level: int
    text: str


class EventLog:
    """Makes log lines from changes between messages."""

    def __init__(self) -> None:
        self._mode: tuple[str, str] | None = None
        self._faults: set[tuple[str, str]] = set()

    def lines(self, key: str, message: Message) -> Iterator[LogLine]:
        """Yields the log lines of a message."""
        match key:
            case "state":
                yield from self._state(message)
            case "request":
                answer = message.get("answer") or {}
                level = INFO if answer.get("accepted") else WARNING
                named = f" {answer['id']}" if answer.get("id") else ""
                outcome = "accepted" if answer.get("accepted") else "refused"
                yield LogLine(level, f"{message.get('key')}{named} {outcome}: {answer.get('message')}")
            case "result":
                level = INFO if message.get("code") == 0 else WARNING
                yield LogLine(level, f"goal {message.get('id')} {message.get('status')}: {message.get('message')}")
            case "alive":
                alive = message.get("alive")
                yield LogLine(INFO if alive else ERROR, "the daemon is there" if alive else "the daemon is gone")

    def _state(self, state: Message) -> Iterator[LogLine]:
        mode = str(state.get("mode")), str(state.get("reason"))
        if mode != self._mode:
            self._mode = mode
            yield LogLine(WARNING if mode[0] in ("fault", "stopped") else INFO, f"{mode[0]}: {mode[1]}")
        faults = {(str(it.get("code")), str(it.get("source"))): it for it in state.get("faults") or ()}
        for key in faults.keys() - self._faults:
            yield LogLine(ERROR, f"{key[0]} at {key[1]}: {faults[key].get('message')}")
        for code, source in sorted(self._faults - faults.keys()):
            yield LogLine(INFO, f"{code} at {source} is gone")
        self._faults = set(faults)
