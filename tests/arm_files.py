"""Documents of arms: a valid one of every section, and ways to change it."""

LABELS = ("left", "diagonal", "right")
TRUSS = {"type": "vgt", "width": 0.2, "lengths": [0.2, 0.25]}


def document(count: int = 2) -> dict:
    """A valid document of a short truss arm, every section of it written out."""
    return {
        "name": "short",
        "modules": [{"type": "vgt", "count": count, "width": 0.2, "lengths": [0.2, 0.25], "first_diagonal": "BC"}],
        "tolerance": {"position": 0.002},
        "travel_time": 0.05,
        "rest_time": 0.5,
        "inrush": 4,
        "base": {"position": [0.5, 0.25], "orientation": 0.1},
        "workspace": {"pixel": 0.01, "memory": 512},
        "method": "ipop-previous",
        "real_time": {"priority": 60},
        "obstacles": [
            {"disc": {"centre": [2, 2], "radius": 0.3}, "name": "pillar"},
            {"box": {"centre": [-1, 1], "size": [0.4, 0.2], "angle": 0.5}},
            {"half_plane": {"point": [0, -0.2], "normal": [0, 1]}, "name": "floor"},
        ],
        "body_radius": 0.02,
        "self_collision": True,
        "buses": [
            {"name": "can0", "interface": "socketcan", "channel": "can0", "bitrate": 500000},
            {"name": "spare", "channel": "can7"},
        ],
        "boards": {"heartbeat": 0.1, "heartbeat_timeout": 0.35, "boot_timeout": 3, "on_loss": "hold"},
        "actuators": [
            {"module": m + 1, "actuator": name, "bus": "can0", "node": m + 1, "output": k, "input": k}
            for m in range(count)
            for k, name in enumerate(LABELS)
        ],
    }


def listed(*states: dict, count: int = 1) -> list[dict]:
    """The `modules` section of modules with listed frames."""
    return [{"type": "transforms", "states": list(states), "count": count}]


def changed(where: str, value) -> dict:
    """The valid document with the field at a path such as "actuators.0.node" set."""
    result = document()
    *path, last = [int(part) if part.isdigit() else part for part in where.split(".")]
    part = result
    for key in path:
        part = part[key]
    part[last] = value
    return result
