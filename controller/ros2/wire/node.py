"""A node: makes publishers, subscribers, services, clients and action servers."""

import contextlib
from collections import Counter, deque
from collections.abc import Callable
from typing import Self, TypeVar

import zenoh

from hyperbit.controller.ros2.wire import names
from hyperbit.controller.ros2.wire import qos as presets
from hyperbit.controller.ros2.wire.actions import ActionServer, GoalHandle, Policy
from hyperbit.controller.ros2.wire.endpoints import (
    Client,
    Endpoint,
    Place,
    Publisher,
    Received,
    Request,
    Service,
    Subscriber,
)
from hyperbit.controller.ros2.wire.qos import Qos
from hyperbit.controller.ros2.wire.session import Session
from hyperbit.controller.ros2.wire.tokens import ADMIN_SPACE, BadToken, Kind, Token, parse
from hyperbit.controller.ros2.wire.types import Types

T = TypeVar("T", bound=Endpoint | ActionServer)
MOST_QUOTED = 200  # letters of a type and its hash
MOST_TOLD = 100  # remembered tokens of reported conflicts
# Kinds of endpoints that exchange messages.
OPPOSITE = {
    Kind.PUBLISHER: Kind.SUBSCRIBER,
    Kind.SUBSCRIBER: Kind.PUBLISHER,
    Kind.SERVICE: Kind.CLIENT,
    Kind.CLIENT: Kind.SERVICE,
}


class Node:
    """A node of ROS 2.

    Args:
        namespace: absolute; "/" is none.
        domain: ROS_DOMAIN_ID.
        distro: of the other nodes: jazzy, kilted or lyrical.
        enclave: of ROS 2's security; "/" is none.

    Raises:
        BadName: name or namespace is not allowed.
        UnknownType: the distribution is not supported.
    """

    def __init__(
        self,
        session: Session,
        name: str,
        namespace: str = "/",
        domain: int = 0,
        distro: str = "jazzy",
        enclave: str = "/",
    ) -> None:
        names.check_node(name, namespace)
        self.types = Types(distro)  # types of the distribution; `types.register` adds others
        self.session = session
        number = session.next_number()
        self.token = Token(domain, session.zid, number, number, Kind.NODE, name, namespace, enclave or "/")
        self._token = session.zenoh.liveliness().declare_token(self.token.text)
        self._place = Place(session, self.types, self.token)
        self._made: list[Endpoint | ActionServer] = []
        self._watching: zenoh.Subscriber[None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def publisher(self, topic: str, type_name: str, qos: Qos = presets.DEFAULT) -> Publisher:
        """Returns a publisher. Names, types and errors are those of `Endpoint`, here and below."""
        return self._keep(Publisher(self._place, topic, type_name, qos))

    def subscriber(
        self, topic: str, type_name: str, callback: Callable[[Received], None], qos: Qos = presets.DEFAULT
    ) -> Subscriber:
        return self._keep(Subscriber(self._place, topic, type_name, callback, qos))

    def service(self, name: str, type_name: str, handler: Callable[[Request], None]) -> Service:
        return self._keep(Service(self._place, name, type_name, handler))

    def client(self, name: str, type_name: str) -> Client:
        return self._keep(Client(self._place, name, type_name))

    def action_server(
        self, name: str, type_name: str, on_goal: Callable[[GoalHandle], None], policy: Policy = Policy()
    ) -> ActionServer:
        """Returns an action server.

        `on_goal` is called with each new goal, in a thread of Zenoh's; it accepts or rejects the goal, then or later.
        """
        return self._keep(ActionServer(self, name, type_name, on_goal, policy))

    def dropped(self) -> dict[str, Counter[str]]:
        """Returns the number of dropped messages by endpoint's name, then by reason."""
        found: dict[str, Counter[str]] = {}
        for it in self._made:
            if isinstance(it, Subscriber | Service) and it.token.endpoint:  # others receive nothing to drop
                found.setdefault(it.token.endpoint.name, Counter()).update(it.dropped)
        return found

    def watch(self, tell: Callable[[str], None]) -> None:
        """Reports nodes and endpoints of others that conflict with this node, each node once.

        A conflict is a second node of this name, or an endpoint of the same name with another type or hash: its
        messages never arrive here. `tell` is called in a thread of Zenoh's.
        """
        told = deque[str](maxlen=MOST_TOLD)

        def on_token(sample: zenoh.Sample) -> None:
            token = str(sample.key_expr)
            if sample.kind != zenoh.SampleKind.PUT:
                with contextlib.suppress(ValueError):
                    told.remove(token)
                return
            try:
                other = parse(token)
            except BadToken:
                return
            # A token that appears just after the subscription comes by itself and with the history.
            if token not in told and (sentence := self._misfit(other)) is not None:
                told.append(token)
                tell(sentence)

        key = f"{ADMIN_SPACE}/{self.token.domain}/**"
        self._watching = self.session.zenoh.liveliness().declare_subscriber(key, on_token, history=True)

    def close(self) -> None:
        """Ends the node and all that it has made. Active goals are aborted."""
        if self._watching is not None:
            with contextlib.suppress(zenoh.ZError):  # the session is closed
                self._watching.undeclare()  # type: ignore[no-untyped-call]
        for it in reversed(self._made):
            it.close()
        self._token.undeclare()  # type: ignore[no-untyped-call]

    def _misfit(self, other: Token) -> str | None:
        """Returns why another node or endpoint conflicts with this node, or None."""
        if (other.zid, other.nid) == (self.token.zid, self.token.nid):
            return None
        name = f"{other.namespace.rstrip('/')}/{other.node}"
        if other.endpoint is None:
            same = (other.node, other.namespace) == (self.token.node, self.token.namespace)
            return f"another node {name} is there: end one of both, or rename it" if same else None
        end, kind = other.endpoint, OPPOSITE[other.kind]
        tokens = (it.token for it in self._made if isinstance(it, Endpoint) and it.token.kind is kind)
        own = next((it.endpoint for it in tokens if it.endpoint and it.endpoint.name == end.name), None)
        if own is None or (end.type, end.hash) == (own.type, own.hash):
            return None
        given, expected = f"{end.type}/{end.hash}"[:MOST_QUOTED], f"{own.type}/{own.hash}"
        return f"{end.name}: no messages are exchanged with {name!r}: its type is {given!r}, expected {expected!r}"

    def _keep(self, made: T) -> T:
        self._made.append(made)
        return made
