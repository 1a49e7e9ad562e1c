"""SDO abort codes in words (CiA 301, 7.2.4.3.17)."""

NO_OBJECT, NO_SUB_INDEX = 0x0602_0000, 0x0609_0011

_WORDS = {
    0x0503_0000: "toggle bit not alternated",
    0x0504_0000: "SDO protocol timed out",
    0x0504_0001: "command specifier not valid",
    0x0504_0005: "out of memory",
    0x0601_0000: "unsupported access to an object",
    0x0601_0001: "attempt to read a write only object",
    0x0601_0002: "attempt to write a read only object",
    NO_OBJECT: "object does not exist",
    0x0604_0041: "object cannot be mapped to the PDO",
    0x0604_0042: "the mapped objects would exceed the PDO length",
    0x0604_0043: "general parameter incompatibility",
    0x0604_0047: "general internal incompatibility in the device",
    0x0606_0000: "access failed due to a hardware error",
    0x0607_0010: "length of the value does not match",
    0x0607_0012: "length of the value too high",
    0x0607_0013: "length of the value too low",
    NO_SUB_INDEX: "sub-index does not exist",
    0x0609_0030: "value out of range",
    0x0609_0031: "value too high",
    0x0609_0032: "value too low",
    0x0609_0036: "maximum is less than minimum",
    0x060A_0023: "resource not available",
    0x0800_0000: "general error",
    0x0800_0020: "value cannot be stored",
    0x0800_0021: "value cannot be stored because of local control",
    0x0800_0022: "value cannot be stored in the present state of the device",
    0x0800_0023: "no object dictionary present",
    0x0800_0024: "no data available",
}


def abort_words(code: int) -> str:
    """An abort code in words, e.g. "object does not exist (abort 06020000h)"."""
    return f"{_WORDS.get(code, 'reason unknown')} (abort {code:08X}h)"
