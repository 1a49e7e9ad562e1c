"""The command `ros2`: shows an arm to a ROS 2 system as a node."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands import ENDPOINT
from hyperbit.controller.commands.arguments import ArmName, Connect, ZenohFile
from hyperbit.controller.commands.common import CommandFailed, arm_name
from hyperbit.controller.commands.process import Process, opened_session
from hyperbit.controller.network.endpoints import parse_endpoint

if TYPE_CHECKING:
    import zenoh

    from hyperbit.controller.ros2.arm_node import Settings
    from hyperbit.controller.ros2.wire.session import Session

ROS = "Zenoh endpoint of ROS 2's router, which `ros2 run rmw_zenoh_cpp rmw_zenohd` starts."
DOMAIN = "ROS_DOMAIN_ID of the ROS 2 system."
DISTRO = "Distribution of the ROS 2 system: jazzy, kilted or lyrical."
NAMESPACE = "Namespace of the node. Default: the arm's name."
WORLD = "Name of the world's frame in /tf."
ORIENTATION = "Goals on goal_pose and goal_path count with their orientation; else the arm chooses its own."
GONE_WITHIN = 15.0  # [s] in which the token of a bridge that was killed disappears
ROUTER_TIMEOUT = 2.0  # [s]
WAITING = "waiting for ROS 2's router, ros2 run rmw_zenoh_cpp rmw_zenohd"


def ros2(
    arm: ArmName,
    ros: Annotated[str, typer.Option(metavar="ENDPOINT", help=ROS)] = "tcp/localhost:7447",
    domain: Annotated[int, typer.Option(min=0, max=232, help=DOMAIN)] = 0,
    distro: Annotated[str, typer.Option(help=DISTRO)] = "jazzy",
    namespace: Annotated[str, typer.Option(help=NAMESPACE, show_default=False)] = "",
    world: Annotated[str, typer.Option(help=WORLD)] = "world",
    orientation: Annotated[bool, typer.Option("--orientation", help=ORIENTATION)] = False,
    connect: Connect = ENDPOINT,
    zenoh_file: ZenohFile = None,
) -> None:
    """Show an arm to a ROS 2 system as a node, without ROS on this computer, until SIGTERM."""
    name = arm_name(arm)
    try:
        from hyperbit.controller.ros2.arm_node import Settings, node_name
        from hyperbit.controller.ros2.wire import names
        from hyperbit.controller.ros2.wire.session import NoRouter, Session
        from hyperbit.controller.ros2.wire.types import Types, UnknownType
    except ImportError as error:
        raise CommandFailed(str(error), "install the libraries of ROS 2: pip install 'hyperbit[ros2]'") from None
    try:
        Types(distro)
    except UnknownType as error:
        raise InputFaults(Path("--distro"), [str(error)]) from None
    try:
        parse_endpoint(ros)
    except ValueError as error:
        raise InputFaults(Path("--ros"), [str(error)]) from None
    settings = Settings(namespace, domain, distro, world, orientation)
    try:
        names.check_node(*node_name(name, namespace))
    except names.BadName as error:
        raise InputFaults(Path("--namespace"), [str(error)]) from None
    process = Process(name)
    process.notifier.notify("READY=1")
    with opened_session(connect, zenoh_file, process) as session:
        network = None if session is None else process.retried(lambda: Session(ros, ROUTER_TIMEOUT), NoRouter, WAITING)
        if session is None or network is None:
            return
        with network:
            check_alone(network, name, settings, process)
            serve(session, network, name, settings, process)


def serve(session: zenoh.Session, network: Session, arm: str, settings: Settings, process: Process) -> None:
    from hyperbit.controller.host.folders import state_folder
    from hyperbit.controller.host.keeper import FileInUse, lock_file
    from hyperbit.controller.network.client import Client
    from hyperbit.controller.network.listener import Listener
    from hyperbit.controller.ros2.bridge import Bridge
    from hyperbit.controller.ros2.goal_book import GoalBook

    own = "".join(f"-{part}" for part in settings.namespace.split("/") if part)
    path = state_folder() / f"{arm}.ros2{own}{f'-domain{settings.domain}' if settings.domain else ''}.json"
    with contextlib.ExitStack() as closing:
        try:
            lock = lock_file(path.with_name(f".{path.name}.lock"), f"end the other bridge: {path} is in use by process")
        except FileInUse as error:
            raise CommandFailed(str(error)) from None
        closing.callback(os.close, lock)
        book = GoalBook(path)
        listener = closing.enter_context(contextlib.closing(Listener(session, arm)))
        client = closing.enter_context(contextlib.closing(Client(session, arm)))
        bridge = closing.enter_context(contextlib.closing(Bridge(listener, client, network, book, settings)))
        bridge.run(process.ending.is_set, process.feed_watchdog)
        process.notifier.notify("STOPPING=1")


def check_alone(network: Session, arm: str, settings: Settings, process: Process) -> None:
    """Checks that no other bridge has this node; the token of one that was killed may still be there for a while."""
    from hyperbit.controller.ros2.arm_node import node_name, tell
    from hyperbit.controller.ros2.wire.tokens import Kind

    node, namespace = node_name(arm, settings.namespace)
    until = time.monotonic() + GONE_WITHIN
    while any(
        (it.kind, it.node, it.namespace) == (Kind.NODE, node, namespace) for it in network.tokens(settings.domain)
    ):
        if time.monotonic() > until:
            text = f"another node {namespace}/{node} is there on domain {settings.domain}: two bridges of one name?"
            tell(network, settings, f"hyperbit_{os.getpid()}", text)
            raise CommandFailed(text, "end the other one, or give this one another --namespace")
        if process.wait():
            return
