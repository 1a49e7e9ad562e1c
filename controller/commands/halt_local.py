"""Halts arms by the sockets of their executors: works with the planner stopped and Zenoh dead, and starts fast."""

import socket
from pathlib import Path

from controller.program import MOST_BYTES, VERSION, Answer, Goodbye, Halt, Hello, Malformed, decode_up, encode
from controller.sockets import found_sockets, socket_path

ANSWER_WITHIN = 1.0  # [s]
JOIN = "become a member of the group of the executor: sudo usermod --append --groups hyperbit USER, or use sudo"
SEARCH = "name the executor's socket or its folder by --socket; an executor starts by: hyperbit run ARM.yaml"


def halt_local(name: str = "", path: Path | None = None) -> str:
    """Halts an arm, or all arms whose executors run on this computer.

    Args:
        name: of the arm; "": all.
        path: of the executor's socket, or of its folder; None: the default ones.

    Returns:
        The executors' answers, one a line.

    Raises:
        Failed: an executor did not answer, or there is none.
    """
    if name:
        sockets = [socket_path(path, name)]
    elif path is not None:
        sockets = [path] if path.suffix == ".sock" else sorted(path.glob("*.sock"))
    else:
        sockets = found_sockets()
    answers, failures, step = [], [], ""
    for own in sockets:
        try:
            answers.append(f"{own.stem}: {halt(own, name)}")
        except OSError as error:
            step = JOIN if isinstance(error, PermissionError) else step
            failures.append(f"{own}: no executor answers ({error.strerror or error})")
        except Malformed as error:
            failures.append(f"{own}: {error}")
    if failures or not sockets:
        from controller.commands.common import Failed

        told = "\n".join([*answers, *failures])
        raise Failed(told or "no executor is running: there is no socket", step if told else SEARCH)
    return "\n".join(answers)


def halt(path: Path, name: str) -> str:
    """Halts the arm of a socket; returns the executor's answer.

    Raises:
        OSError: the executor does not answer.
        Malformed: it answers something else.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
        connection.settimeout(ANSWER_WITHIN)
        connection.connect(str(path))
        connection.send(encode(Hello(VERSION, "operator", name)))
        connection.send(encode(Halt(1)))
        while True:
            data = connection.recv(MOST_BYTES + 1)
            if not data:
                raise ConnectionAbortedError(None, "it has closed the connection")
            match decode_up(data):
                case Answer() as answer:
                    return answer.message
                case Goodbye() as goodbye:
                    raise ConnectionRefusedError(None, goodbye.reason)
