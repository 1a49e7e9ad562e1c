"""Whether a message is what its JSON schema says, as far as the recorder's schemas go."""

from typing import Any

TYPES: dict[str, tuple[type, ...]] = {
    "number": (int, float),
    "integer": (int,),
    "string": (str,),
    "boolean": (bool,),
    "null": (type(None),),
    "object": (dict,),
    "array": (list,),
}


def misfits(value: Any, schema: dict[str, Any], path: str = "message", strict: bool = False) -> list[str]:
    """What is wrong with a value, by its path; `strict`: also fields that the schema does not have."""
    if "anyOf" in schema:
        found = [misfits(value, choice, path, strict) for choice in schema["anyOf"]]
        return min(found, key=len)
    if "enum" in schema:
        return [] if value in schema["enum"] else [f"{path} is {value!r}, none of {schema['enum']}"]
    if (kind := schema.get("type")) is None:  # anything
        return []
    if not isinstance(value, TYPES[kind]) or (isinstance(value, bool) and kind != "boolean"):
        return [f"{path} is {value!r}, no {kind}"]
    if kind == "array":
        return [it for k, part in enumerate(value) for it in misfits(part, schema["items"], f"{path}[{k}]", strict)]
    if kind != "object":
        return []
    known = schema.get("properties", {})
    wrong = [it for key in known.keys() & value.keys() for it in misfits(value[key], known[key], f"{path}.{key}")]
    return wrong + [f"{path}.{key} is not in the schema" for key in value.keys() - known.keys() if strict]
