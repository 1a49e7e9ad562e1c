"""What a stranger may send on the keys of an arm: messages of their own form, of other forms, and none."""

import json

import zenoh

from tests.documents.facts import listened

OWN_FORM = [
    {"at": 5.0, "begin": 0.0, "end": 9.0, "speed": 1.0, "paused": False, "file": "x"},
    {"stamp": 1.0, "key": "goal", "payload": {"id": "forged"}, "answer": {"accepted": True, "id": "forged"}},
    {"id": "forged", "status": "succeeded", "code": 0, "message": "forged", "waypoint": 0, "waypoints": 1},
    {"deletions": [], "entities": "forged", "transforms": []},
    {"save": "home", "role": "viewer", "replay": True, "section": "you", "alive": False},
]
PAYLOADS = [b"", b"null", b"[]", b"{}", b"5", b'"id"', b"\xff\xfe", b"[" * 5_000, *map(json.dumps, OWN_FORM)]
KEYS = sorted({*listened(), "gone", "scene", "frames", "log", "other", "some/key"})


def intrude(session: zenoh.Session, prefix: str, keys: list[str] = KEYS) -> None:
    """Puts each payload on each key below `prefix`, and deletes the key."""
    for key in keys:
        for payload in PAYLOADS:
            session.put(f"{prefix}/{key}", payload, congestion_control=zenoh.CongestionControl.BLOCK)
        session.delete(f"{prefix}/{key}")
