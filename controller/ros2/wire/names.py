"""Names of ROS 2, and their form in keys of rmw_zenoh."""

import re

SLASH = "%"  # stands for a slash inside one field of a liveliness token
MOST_LETTERS = 255  # of a name, as in rmw
TOKEN = r"(?!\w*__)[A-Za-z_]\w*"
NAME = re.compile(rf"(?:/|~/)?{TOKEN}(?:/{TOKEN})*", re.ASCII)
NAMESPACE = re.compile(rf"/|(?:/{TOKEN})+", re.ASCII)
NODE = re.compile(TOKEN, re.ASCII)
TYPE = re.compile(r"([a-z]\w*)/(msg|srv|action)/([A-Z]\w*)", re.ASCII)
RULE = "letters, digits and single underscores, no digit first, parts separated by one slash"


class BadName(ValueError):
    """A name is not valid in ROS 2."""


def resolve(name: str, namespace: str, node: str) -> str:
    """Returns the absolute name of a topic, service or action; raises BadName.

    `name` is absolute ("/tf"), relative to the namespace ("goal") or private to the node ("~/goal").
    """
    if not NAME.fullmatch(name) or len(name) > MOST_LETTERS:
        raise BadName(f"{name!r} is no name of a topic, service or action: {RULE}")
    if name.startswith("/"):
        return name
    prefix = namespace.rstrip("/")
    return f"{prefix}/{node}{name[1:]}" if name.startswith("~") else f"{prefix}/{name}"


def check_node(name: str, namespace: str) -> None:
    """Raises BadName if a node's name or its namespace is not allowed."""
    if not NODE.fullmatch(name) or len(name) > MOST_LETTERS:
        raise BadName(f"{name!r} is no name of a node: letters, digits and single underscores, no digit first")
    if not NAMESPACE.fullmatch(namespace) or len(namespace) > MOST_LETTERS:
        raise BadName(f"{namespace!r} is no namespace: a slash, then {RULE}")


def mangle(name: str) -> str:
    """Returns a name as one field of a liveliness token."""
    return name.replace("/", SLASH)


def demangle(field: str) -> str:
    return field.replace(SLASH, "/")


def dds_type(name: str) -> str:
    """Returns a type's name in keys, as std_msgs::msg::dds_::String_. Raises BadName for another form."""
    parts = TYPE.fullmatch(name)
    if not parts:
        raise BadName(f"{name!r} is no type: it has the form package/msg/Name, package/srv/Name or package/action/Name")
    return f"{parts[1]}::{parts[2]}::dds_::{parts[3]}_"


def data_key(domain: int, name: str, type_name: str, type_hash: str) -> str:
    """Returns the key of a topic's samples or of a service's queries; `name` is absolute, `type_hash` is RIHS01."""
    return f"{domain}/{name.strip('/')}/{dds_type(type_name)}/{type_hash}"
