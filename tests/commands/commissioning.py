"""A commission as a process, whose questions come over Zenoh, as a page gets them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import IO, Any

import yaml
import zenoh

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client
from tests.endpoints import free_endpoint
from tests.waiting import eventually

Message = dict[str, Any]


class Commission:
    """A running command, and a client that has the role of a page.

    Attributes:
        states: all that were published, in order.
    """

    def __init__(self, folder: Path, name: str, *words: str) -> None:
        self.folder, endpoint = folder, free_endpoint()
        command = [sys.executable, "-m", "hyperbit", "commission", "arm.yaml", "--watch", "0.3", "--page"]
        own = {**os.environ, "XDG_RUNTIME_DIR": str(folder), "HOME": str(folder)}
        self._log = (folder / "told").open("w+")
        self.process = subprocess.Popen(
            [*command, "--listen", endpoint, *words], cwd=folder, stdin=subprocess.PIPE, stdout=self._log,
            stderr=subprocess.STDOUT, text=True, env=own,
        )  # fmt: skip
        self.states: list[Message] = []
        self._number = -1
        eventually(lambda: self.process.poll() is not None or "ask the same" in self.told, told=lambda: self.told)
        self._session = zenoh.open(session.configuration("client", connect=endpoint))
        self.client = Client(self._session, name)
        self._states = self.client.subscribe("state", self.states.append)

    @property
    def told(self) -> str:
        return Path(self._log.name).read_text()

    def asked(self, *words: str) -> Message:
        """Waits for a question with these words; returns the state that has it."""

        def question() -> Message | None:
            state = self.states[-1] if self.states else {}
            it = (state.get("commission") or {}).get("question") or {}
            return state if it and all(word in it["text"] for word in words) else None

        return eventually(question, told=lambda: f"{words}: {self.states[-1:]} {self.told}") or {}

    def next_question(self) -> Message | None:
        """Waits for a question that was not asked yet, and returns its state; None if the command ends before."""

        def news() -> list[Message | None]:
            if self.process.poll() is not None:
                return [None]
            state = self.states[-1] if self.states else {}
            question = (state.get("commission") or {}).get("question")
            return [state] if question and question["number"] != self._number else []

        state = eventually(news, told=lambda: self.told)[0]
        if state is not None:
            self._number = state["commission"]["question"]["number"]
        return state

    def answer(self, state: Message, answer: str, **fields: Any) -> Message:
        """Answers the question of a state."""
        number = state["commission"]["question"]["number"]
        return self.client.request("answer", {"question": number, "answer": answer, "stamp": state["stamp"], **fields})

    def says(self, words: str, answer: str) -> None:
        assert self.answer(self.asked(words), answer)["accepted"]

    def type(self, line: str) -> None:
        stdin: IO[str] | None = self.process.stdin
        assert stdin is not None
        stdin.write(f"{line}\n")
        stdin.flush()

    def kill(self) -> None:
        self.process.kill()
        self.close()

    def close(self) -> None:
        """Waits for the end of the command."""
        self.process.wait(60)
        self._states.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]
        self._log.close()


def right_answer(text: str, file: Path, true: Path) -> str:
    """Returns the answer of a person beside an arm that is wired as another file says; it has an output an actuator."""
    match text.split():
        case ["ready", *_]:
            return ""
        case [label, "was", "told", "to", verb, *_]:
            (node, output, inverted), wired = outputs(file)[label], outputs(true)
            moved, turned = next((one, it[2]) for one, it in wired.items() if it[:2] == (node, output))
            end = "ec"[verb.startswith("contract") ^ inverted ^ turned]
            return end if moved == label else f"{moved} {end}"
        case ["write", *_]:
            return "y"
    return "r"


def outputs(file: Path) -> dict[str, tuple[int, int, bool]]:
    """Returns node, bit and inversion of each actuator's output."""
    found = {}
    for row in yaml.safe_load(file.read_text())["actuators"]:
        output = row["output"] if isinstance(row["output"], dict) else {"bit": row["output"]}
        found[f"{row['module']}.{row['actuator']}"] = row["node"], output["bit"], output.get("inverted", False)
    return found


def record(folder: Path) -> list[tuple[str, int]]:
    """Returns the actuators and states of the record's sightings."""
    return [
        (it["actuator"], it["state"]) for it in json.loads((folder / "arm.commission.json").read_text())["sightings"]
    ]
