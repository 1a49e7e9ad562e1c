"""The object dictionary that an EDS or DCF describes, in full or in the compact forms of CiA 306-1."""

from __future__ import annotations

import copy
from typing import NamedTuple

from hyperbit.drivers.canopen.tools.eds_file import Section, UnreadableEds, parse_number, read

_SIZES = {0x01: 1, 0x02: 1, 0x03: 2, 0x04: 4, 0x05: 1, 0x06: 2, 0x07: 4, 0x08: 4, 0x10: 3, 0x11: 8, 0x12: 5, 0x13: 6}
_SIZES |= {0x14: 7, 0x15: 8, 0x16: 3, 0x18: 5, 0x19: 6, 0x1A: 7, 0x1B: 8}  # lengths of data types [bytes]
_REALS = (0x08, 0x11)
_VALUES = ("lowlimit", "highlimit", "defaultvalue", "parametervalue")
_UNSIGNED8, _UNSIGNED16, _UNSIGNED32 = 5, 6, 7
_ARRAY = 8  # ObjectType
_RPDOS, _RPDO_MAPPINGS, _TPDOS, _TPDO_MAPPINGS = (range(first, first + 0x200) for first in range(0x1400, 0x1C00, 0x200))
_DUMMIES = range(1, 8)  # indices of the dummy entries of RPDOs
_ACCESS = {"ro", "wo", "rw", "rwr", "rww", "const"}
_OTHER_ACCESS = {"r": "ro", "w": "wo", "wr": "rw", "rw/rw": "rw"}  # seen in files
_COMPACT_PDO = {1: _UNSIGNED32, 2: _UNSIGNED8, 3: _UNSIGNED16, 5: _UNSIGNED16, 6: _UNSIGNED8}  # by sub-index
_MOST_MAPPED = 64  # entries of a mapping


class Entry(NamedTuple):
    """One entry of the dictionary; None: the file does not give it."""

    access: str | None  # "ro", "wo", "rw", "rwr", "rww" or "const"
    data_type: int | None  # index
    mappable: bool = False  # into a PDO
    low: int | None = None  # least value
    high: int | None = None  # greatest value
    value: int | None = None  # after power-on
    configured: bool = False  # the value is a DCF's ParameterValue, not a DefaultValue

    @property
    def readable(self) -> bool:
        """Whether SDO can read the entry; True if the access is unknown."""
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        return self.access in ("wo", "rw", "rwr", "rww")

    @property
    def size(self) -> int:
        """Length [bytes]; 0 for a type that is no number."""
        return _SIZES.get(self.data_type or 0, 0)


def is_mapping(index: int) -> bool:
    return index in _RPDO_MAPPINGS or index in _TPDO_MAPPINGS


class Eds:
    """The object dictionary in the content of an EDS; `node` is part of COB-IDs. Raises UnreadableEds."""

    def __init__(self, content: bytes, node: int) -> None:
        self._file = read(content)
        if not self._file.objects:
            raise UnreadableEds("no EDS: it describes no object, for instance in a section [1000]")
        self._node = node
        self._found: dict[tuple[int, int], Entry | None] = {}
        self.notes = self._file.notes  # violations of CiA 306-1 in the entries that were asked for
        self.of_modules = self._file.of_modules  # indices of objects that come with modules of a coupler
        self._device = self._file.others.get("deviceinfo", {})
        granularity = self._number("DeviceInfo", self._device, "granularity")
        self.fixed_mappings = granularity == 0  # whether no mapping can be changed
        self._compact = self._number("DeviceInfo", self._device, "compactpdo") or 0

    def at(self, node: int) -> Eds:
        """Returns the dictionary of another board of this kind."""
        other = copy.copy(self)
        other._node, other._found = node, {}
        return other

    def find(self, index: int, sub: int) -> Entry | None:
        place = index, sub
        if place not in self._found:
            self._found[place] = self._described(index, sub)
        return self._found[place]

    def value(self, index: int, sub: int) -> int | None:
        """Returns the value after power-on; None if the file does not give it."""
        entry = self.find(index, sub)
        return None if entry is None else entry.value

    def subs(self, index: int) -> int:
        """Returns the greatest sub-index that the file describes."""
        return max((sub or 0 for sub in self._file.objects.get(index, ())), default=0)

    def says(self, index: int, sub: int) -> str:
        """Returns in words what the file says about an entry."""
        if index in _DUMMIES:
            return f"Dummy{index:04d}={int(self.find(index, 0) is not None)}"
        entry = self.find(index, sub)
        if entry is None:
            return "that modules bring it" if index in self.of_modules else "nothing of it"
        key = "ParameterValue" if entry.configured else "DefaultValue"
        told = {
            "AccessType": entry.access,
            "PDOMapping": int(entry.mappable),
            "DataType": f"{entry.data_type or 0:#06x}",
            "LowLimit": entry.low,
            "HighLimit": entry.high,
            key: None if entry.value is None else f"{entry.value:#x}",
            "Granularity": 0 if is_mapping(index) and self.fixed_mappings else None,
        }
        return ", ".join(f"{key}={value}" for key, value in told.items() if value is not None)

    def _described(self, index: int, sub: int) -> Entry | None:
        """Returns an entry from its own section, a compact form, or a similar entry."""
        if index in _DUMMIES:
            used = self._number("DummyUsage", self._file.others.get("dummyusage", {}), f"dummy{index:04d}")
            return Entry("const", index, True) if used and sub == 0 else None
        sections = self._file.objects.get(index)
        if sections is None:
            return self._of_compact_pdo(index, sub)
        title = f"{index:04X}sub{sub:X}"
        if sub in sections:
            return self._entry(title, sections[sub], sections.get(None, {}))
        whole = sections.get(None, {})
        if compact := self._number(f"{index:04X}", whole, "compactsubobj"):
            return self._of_compact_object(index, sub, whole, compact)
        if sub == 0:
            return self._entry(f"{index:04X}", whole, {}) if len(sections) == 1 else Entry("ro", _UNSIGNED8)
        if 1 in sections and sub <= self._like_first(index, whole):
            return self._entry(title, sections[1], whole)._replace(value=None)
        return None

    def _like_first(self, index: int, whole: Section) -> int:
        """Returns the greatest sub-index that sub-index 1 alone may describe, in an array or a mapping."""
        if is_mapping(index):
            number = self.find(index, 0)
            return min(_MOST_MAPPED, (number.high or 0) if number else 0)
        array = self._number(f"{index:04X}", whole, "objecttype") == _ARRAY
        return (self.value(index, 0) or 0) if array else 0

    def _of_compact_object(self, index: int, sub: int, whole: Section, count: int) -> Entry | None:
        """CompactSubObj: sub-index 0 is the number of the others, which are alike.

        Sub-index 0 is read-only (CiA 306-1), but generators of DCFs use the form for mappings that can be changed, too.
        """
        if sub > count:
            return None
        entry = self._entry(f"{index:04X}", whole, {})
        if sub == 0:
            return Entry(None if is_mapping(index) and entry.writable else "ro", _UNSIGNED8, value=count)
        value = self._number(f"{index:04X}Value", self._file.others.get(f"{index:04x}value", {}), str(sub))
        return entry if value is None else entry._replace(value=value, configured=True)

    def _of_compact_pdo(self, index: int, sub: int) -> Entry | None:
        """CompactPDO of DeviceInfo: bit k says that the parameters of all PDOs have sub-index k + 1."""
        rpdo = index in _RPDOS or index in _RPDO_MAPPINGS
        count = self._number("DeviceInfo", self._device, "nrofrxpdo" if rpdo else "nroftxpdo") or 0
        if not self._compact or index not in range(0x1400, 0x1C00) or index & 0x1FF >= count:
            return None
        if is_mapping(index):
            return Entry("rw", _UNSIGNED32 if sub else _UNSIGNED8) if sub <= _MOST_MAPPED else None
        if sub == 0:
            return Entry("ro", _UNSIGNED8)
        if sub not in _COMPACT_PDO or not self._compact >> (sub - 1) & 1:
            return None
        return Entry("rw", _COMPACT_PDO[sub])

    def _entry(self, title: str, section: Section, whole: Section) -> Entry:
        """Parses a section; `whole` may give the data type."""
        data_type = self._number(title, section, "datatype")
        if data_type is None:
            data_type = _UNSIGNED8 if title.endswith("sub0") else self._number(title, whole, "datatype")
        mappable = bool(self._number(title, section, "pdomapping"))
        entry = Entry(self._access(title, section), data_type, mappable)
        if data_type not in _SIZES or data_type in _REALS:
            return entry
        low, high, default, configured = (self._number(title, section, key) for key in _VALUES)
        value = default if configured is None else configured
        return entry._replace(low=low, high=high, value=value, configured=configured is not None)

    def _access(self, title: str, section: Section) -> str | None:
        key = section.get("accesstype")
        if key is None or not key.text:
            return None
        access = key.text.lower()
        access = _OTHER_ACCESS.get(access, access)
        if access in _ACCESS:
            return access
        self._note(f"line {key.line}, [{title}]: {key.name}={key.text} is none of {', '.join(sorted(_ACCESS))}")
        return None

    def _number(self, title: str, section: Section, name: str) -> int | None:
        key = section.get(name)
        if key is None or not key.text:
            return None
        number = parse_number(key.text, self._node)
        if number is None:
            self._note(f"line {key.line}, [{title}]: {key.name}={key.text} is no number")
        return number

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)
