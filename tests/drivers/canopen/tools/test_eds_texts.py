"""EDS and DCF texts with the peculiarities of makers' files: each is read, and gets the right verdict."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.tools.eds import Eds
from hyperbit.drivers.canopen.tools.eds_check import unmet
from hyperbit.drivers.canopen.tools.eds_file import UnreadableEds, parse_number
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from tests.drivers.canopen.tools.changes import TEXT, Change, add, both, compact, drop, put, swap, without

CHANNELS = (Channel("a", "can0", 5, 0, 0), Channel("b", "can0", 5, 25, 25))

MODULES = (
    "[SupportedModules]\nNrOfEntries=1\n\n[M1ModuleInfo]\nProductName=8DO\n\n[M1SubExtends]\nNrOfEntries=1\n1=0x6200\n"
)
LISTED = (
    "[SupportedModules]\nNrOfEntries=2\n\n[M1FixedObjects]\nNrOfEntries=1\n1=0x6000\n\n"
    "[M2FixedObjects]\nNrOfEntries=1\n1=0x6200\n\n[ConnectedModules]\nNrOfEntries=2\n1=1\n2=2"
)
MODULE = "\n[M1SubExt6200]\nParameterName=v\nDataType=0x0005\nAccessType=rww\nPDOMapping=1\nCount=1\nObjExtend=0\n"

FITS: dict[str, Change] = {
    "as it is": lambda text: text,
    "CR LF": lambda text: text.replace("\n", "\r\n"),
    "an empty line after each line": lambda text: text.replace("\n", "\n\n"),
    "spaces around =": lambda text: re.sub(r"^(\w+)=", r"\1 = ", text, flags=re.MULTILINE),
    "tabs before keys": lambda text: re.sub(r"^(\w+)=", r"\t\1=", text, flags=re.MULTILINE),
    "all in lower case": str.lower,
    "all in upper case but the prefix of numbers": lambda text: text.upper().replace("0X", "0x"),
    "sub in another case": lambda text: re.sub(r"^\[(\w{4})sub", r"[\1Sub", text, flags=re.MULTILINE),
    "sub-indices of two digits": lambda text: re.sub(r"^\[(\w{4})sub(\w)\]", r"[\1sub0\2]", text, flags=re.MULTILINE),
    "spaces in titles": lambda text: re.sub(r"^\[(\w+)\]", r"[ \1 ]", text, flags=re.MULTILINE),
    "text behind titles": lambda text: re.sub(r"^(\[\w+\])", r"\1 ; object", text, flags=re.MULTILINE),
    "0x before an index": lambda text: re.sub(r"^\[([16]\w{3})", r"[0x\1", text, flags=re.MULTILINE),
    "no vendor": put("DeviceInfo", "VendorNumber="),
    "a vendor with leading zeros": put("DeviceInfo", "VendorNumber=001"),
    "a product in words": put("DeviceInfo", "ProductNumber=AB 8xx"),
    "a revision as text": put("DeviceInfo", "RevisionNumber=V1.0"),
    "no DeviceInfo": drop("DeviceInfo"),
    "no FileInfo": drop("FileInfo"),
    "words in FileInfo": swap("[FileInfo]", "[FileInfo]\nmade by hand"),
    "words before the first section": lambda text: f"This file describes a board\n{text}",
    "no DummyUsage": drop("DummyUsage"),
    "DummyUsage in part": swap("Dummy0001=1\n", ""),
    "no lists of objects": drop("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"),
    "lines of comments that are not counted": add("[Comments]\nLines=5\nline1=one\nLine3=three"),
    "fewer PDOs counted than described": put("DeviceInfo", "NrOfRXPDO=0"),
    "a key twice": swap("FileVersion=1\n", "FileVersion=1\nFileVersion=1\n"),
    "a key twice with other values": swap("FileVersion=1\n", "FileVersion=1\nFileVersion=2\n"),
    "a section twice": add("[1001]\nParameterName=again"),
    "a later section that says otherwise": add("[1017]\nAccessType=const"),
    "a line without =": swap("[1001]\n", "[1001]\nObjFlags\n"),
    "a sub-index without its object": add("[2022sub0]\nParameterName=v\nObjectType=7\nDataType=5\nAccessType=ro"),
    "a comment behind a value": lambda text: re.sub(r"^(ObjectType=\S+)", r"\1 # VAR", text, flags=re.MULTILINE),
    "a comment behind ;": lambda text: re.sub(r"^(DataType=\S+)", r"\1   ; type", text, flags=re.MULTILINE),
    "values in quotes": lambda text: re.sub(r"^(AccessType)=(\S+)", r'\1="\2"', text, flags=re.MULTILINE),
    "no ObjectType": without("ObjectType"),
    "no SubNumber": without("SubNumber"),
    "no ParameterName": without("ParameterName"),
    "empty limits": lambda text: re.sub(r"^(DataType=.*)", r"\1\nLowLimit=\nHighLimit=", text, flags=re.MULTILINE),
    "empty PDOMapping of sub-indices 0": lambda text: re.sub(
        r"(sub0\]\n(?:.+\n)*?)PDOMapping=0", r"\1PDOMapping=", text
    ),
    "limits as text": put("1017", "HighLimit=max"),
    "no DataType of a sub-index 0": lambda text: re.sub(r"(\[6200sub0\]\n(?:.+\n)*?)DataType=.*\n", r"\1", text),
    "data types in decimal": lambda text: re.sub(r"DataType=0x000(\d)", r"DataType=\1", text),
    "the node id behind": swap("$NODEID+0x200", "0x200+$NODEID"),
    "the node id with spaces": swap("$NODEID+0x200", "$NODEID + 0x200"),
    "the node id in another case": swap("$NODEID+0x200", "$NodeId+0x200"),
    "a COB-ID in decimal": swap("$NODEID+0x200", "$NODEID+512"),
    "a disabled COB-ID": swap("$NODEID+0x200", "$NODEID+0x80000200"),
    "a COB-ID of another node in a DCF": put("1400sub1", "ParameterValue=0x220"),
    "an unknown data type elsewhere": add("[2000]\nParameterName=v\nDataType=0x0044\nAccessType=ro"),
    "access R of another object": add("[2000]\nParameterName=v\nDataType=7\nAccessType=R"),
    "a real number elsewhere": add("[2000]\nParameterName=v\nDataType=8\nAccessType=ro\nDefaultValue=1.5"),
    "a text elsewhere": add("[1008]\nDefaultValue=a; b = c"),
    "a domain with its file": add("[1F50sub1]\nDataType=0xF\nAccessType=wo\nUploadFile=a.bin"),
    "compact arrays": both(compact("6000", "ro", 1), compact("6200", "rww", 1), compact("6206", "rw", 0, "0xFF")),
    "a compact array as a record": compact("6200", "rww", 1, kind=9),
    "a compact array of 254": compact("6200", "rww", 1, count="0xFE"),
    "compact values of a DCF": both(
        compact("6202", "rw", 0, "0"), add("[6202Value]\nNrOfEntries=1\n1=0x0"), compact("6200", "rww", 1)
    ),
    "compact PDOs": both(
        drop("1400", "1800", "1600", "1A00"), put("DeviceInfo", "CompactPDO=0x2F"), put("DeviceInfo", "Granularity=8")
    ),
    "a record that counts more than it describes": both(drop("1400sub5"), put("1400sub0", "DefaultValue=5")),
    "mapping entries described in part": lambda text: put("1600sub0", "HighLimit=64")(
        re.sub(r"^\[1600sub[2-8]\]\n(?:(?!\[).*\n?)*", "", text, flags=re.MULTILINE)
    ),
    "modules that bring other objects": add(MODULES.replace("6200", "6411") + MODULE.replace("6200", "6411")),
    "the value of a DCF that fits": put("6202sub1", "ParameterValue=0"),
    "empty values of a DCF": lambda text: re.sub(
        r"^(DefaultValue=.*)", r"\1\nParameterValue=", text, flags=re.MULTILINE
    ),
    "a value of a whole record": put("1600", "ParameterValue=2"),
    "keys in comments": lambda text: re.sub(r"^(DataType=.*)", r";StorageLocation=RAM\n\1", text, flags=re.MULTILINE),
    "dummies of all types": swap("[DummyUsage]\n", "[DummyUsage]\nDummy0010=1\nDummy001B=1\n"),
    "mappable in hexadecimal": lambda text: re.sub(r"^PDOMapping=(\d)", r"PDOMapping=0x\1", text, flags=re.MULTILINE),
    "a producer of SYNC": put("1005", "DefaultValue=0x40000080"),
    "no remote frames": put("1800sub1", "DefaultValue=$NODEID+0x40000180"),
    "a sub-index FF": add("[2000]\nObjectType=8\nSubNumber=0xFF\n\n[2000subFF]\nDataType=5\nAccessType=rw"),
    "a history of 255": compact("1003", "ro", 0, count="255"),
    "a compact array beside its entries": add(
        "[2000]\nObjectType=8\nSubNumber=1\nCompactSubObj=1\n\n[2000sub1]\nDataType=5\nAccessType=rw"
    ),
    "links, denotations and sections of a maker": add(
        "[2000ObjectLinks]\nObjectLinks=1\n1=0x1000\n\n[2000Denotation]\nNrOfEntries=1\n1=a\n\n[Maker]\nKey=1.2.3"
    ),
    "UTF-8 with a mark": lambda text: "\ufeff" + text,
    "zeros at the end": lambda text: text + "\0\0\0",
    "all bits of the device type": put("1000", "DefaultValue=0x000F0191"),
    "another SYNC, which can be written": put("1005", "DefaultValue=0x85"),
    "a transmission type of its RPDO that cannot be written": put("1400sub2", "AccessType=const"),
    "a TPDO on SYNC": put("1800sub2", "DefaultValue=1"),
    "a read-only mapping that suffices": put("1600sub0", "AccessType=ro"),
    "no mapping but what is delivered": put("DeviceInfo", "Granularity=0"),
    "a limit that the heartbeat keeps": put("1017", "LowLimit=100"),
}

LACKS: dict[str, tuple[Change, str]] = {
    "outputs that cannot be read": (put("6200sub1", "AccessType=wo"), "refuses to read 6200h sub 1"),
    "a read-only consumer": (put("1016sub1", "AccessType=ro"), "007F015Eh is needed"),
    "no heartbeat": (drop("1017"), "1017h sub 0: the EDS says nothing of it"),
    "a limit too high": (put("1017", "LowLimit=500"), "value too low (abort 06090032h)"),
    "a read-only error mode": (put("6206sub1", "AccessType=ro"), "6206h sub 1: the EDS says AccessType=ro"),
    "a wrong type": (put("6005", "DataType=0x0006"), "answers 2 bytes to 6005h sub 0; 1 are"),
    "a limit in another case": (put("1017", "Highlimit=0x10"), "1017h sub 0"),
    "a limit too low": (put("1017", "HighLimit=50"), "value too high (abort 06090031h)"),
    "a fixed mapping in another case": (
        both(
            put("DeviceInfo", "Granularity=0"), swap("[DeviceInfo]", "[deviceinfo]"), put("1600sub0", "DefaultValue=1")
        ),
        "Granularity=0",
    ),
    "a DCF that inverts outputs": (put("6202sub1", "ParameterValue=0xFF"), "ParameterValue=0xff"),
    "compact values of a DCF that invert": (
        both(compact("6202", "rw", 0, "0"), add("[6202Value]\nNrOfEntries=1\n1=0xFF")),
        "6202h sub 1",
    ),
    "mapping entries that nobody describes": (
        both(put("1600sub0", "DefaultValue=0"), put("1600sub0", "HighLimit="), drop("1600sub[2-8]")),
        "1600h sub 2",
    ),
    "too few bytes in a compact array": (compact("6200", "rww", 1, count="2"), "sub 4 is needed"),
    "access R": (both(put("1600sub0", "DefaultValue=0"), swap("AccessType=rww", "AccessType=R")), "cannot be mapped"),
    "no supervision": (drop("1016", "1017"), "1016h"),
    "no outputs": (drop("6200"), "6200h"),
    "another profile": (put("1000", "DefaultValue=0x00030192"), "0191h"),
}

OPEN: dict[str, tuple[Change, str]] = {
    "outputs that modules bring": (both(drop("6200"), add(MODULES + MODULE)), "modules bring it"),
    "outputs in a module's list": (both(drop("6200"), add(LISTED)), "modules bring it"),
    "outputs that a module describes": (
        both(drop("6200"), add("[M1Fixed6200]\nParameterName=v\n\n[M1Fixed6200sub1]\nDataType=5")),
        "modules bring it",
    ),
    "a compact mapping": (
        both(
            drop("1600"),
            add(
                "[1600]\nObjectType=9\nDataType=7\nAccessType=rw\nCompactSubObj=1\n\n[1600Value]\nNrOfEntries=1\n1=0x20000108"
            ),
        ),
        "1600h sub 0",
    ),
    "a limit that leaves no room for a node id": (put("1016sub1", "HighLimit=65535"), "1016h sub 1"),
    "a type that cannot be read": (put("1017", "DataType=word"), "1017h"),
    "an access that cannot be read": (put("1016sub1", "AccessType=allowed"), "1016h sub 1"),
    "a read-only value that is not told": (
        both(put("1016sub1", "AccessType=ro"), put("1016sub1", "DefaultValue=")),
        "1016h sub 1",
    ),
}


def verdict(folder: Path, text: str, encoding: str = "utf-8") -> tuple[str, str, list[str]]:
    """Returns the verdict on a text, the sentences on what is unmet, and the notes."""
    path = folder / "board.eds"
    path.write_text(text, encoding=encoding, newline="")
    wiring = Wiring((BusWiring("can0", "none", "can0"),), CHANNELS)
    [board] = lay_out(wiring).boards
    eds = Eds(path.read_bytes(), 5)
    found = unmet(eds, board, Timing())
    kind = "fits" if not found else "lacks" if any(lack.told for lack in found) else "open"
    return kind, "; ".join(map(str, found)), eds.notes


@pytest.mark.parametrize("name", FITS)
def test_peculiar_files_of_right_boards_fit(tmp_path, name):
    text = FITS[name](TEXT)
    assert name == "as it is" or text != TEXT
    assert verdict(tmp_path, text)[:2] == ("fits", "")


@pytest.mark.parametrize("name", [*LACKS, *OPEN])
def test_a_lack_is_told_and_what_an_eds_does_not_tell_is_none(tmp_path, name):
    change, words = {**LACKS, **OPEN}[name]
    kind, text, _ = verdict(tmp_path, change(TEXT))
    assert kind == ("lacks" if name in LACKS else "open"), text
    assert words in text


def test_an_absent_device_type_is_one_lack(tmp_path):
    kind, text, _ = verdict(tmp_path, drop("1000")(TEXT))
    assert kind == "lacks"
    assert text.count("the EDS says") == 1, text


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin-1", "cp1252"])
def test_encodings_of_files(tmp_path, encoding):
    text = put("DeviceInfo", "VendorName=Bürkert")(TEXT)
    assert verdict(tmp_path, text, encoding)[0] == "fits"


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (swap("[1001]\n", "[1001]\nObjFlags\n"), "[1001]: ObjFlags has no '='"),
        (put("1017", "HighLimit=max"), "[1017]: HighLimit=max is no number"),
        (put("1016sub1", "AccessType=allowed"), "[1016sub1]: AccessType=allowed is none of const, ro, rw"),
        (swap("FileVersion=1\n", "FileVersion=1\nFileVersion=2\n"), "[FileInfo]: FileVersion=2 is skipped, for line "),
    ],
)
def test_what_cannot_be_understood_is_noted_with_its_line(tmp_path, change, note):
    text = change(TEXT)
    notes = verdict(tmp_path, text)[2]
    [told] = [one for one in notes if note in one]
    line = text.splitlines()[int(told.split()[1].rstrip(",")) - 1]
    assert line.partition("=")[0] in told


def test_an_eds_serves_several_boards(tmp_path):
    path = tmp_path / "board.eds"
    path.write_text(TEXT)
    eds = Eds(path.read_bytes(), 5)
    assert eds.value(0x1400, 1) == 0x205
    assert eds.at(9).value(0x1400, 1) == 0x209
    assert eds.value(0x1400, 1) == 0x205


@given(st.integers(-(2**31), 2**32 - 1), st.integers(1, 127))
def test_numbers_are_read_as_they_are_written(value, node):
    assert parse_number(str(value), node) == value
    assert parse_number(hex(value), node) == value
    assert parse_number(f"0{abs(value):o}", node) == abs(value)
    assert parse_number(f"$NODEID+{value:#x}", node) == value + node


@pytest.mark.parametrize("text", ["", "x", "0x", "1_000", "12 34", "$NODEID+", "1.5", "--1", "0x12G", "٣"])
def test_what_is_no_number_is_none(text):
    assert parse_number(text, 5) is None


@settings(max_examples=50)
@given(st.data())
def test_no_text_raises_another_error(tmp_path_factory, data):
    lines = TEXT.splitlines()
    for _ in range(data.draw(st.integers(1, 12))):
        k = data.draw(st.integers(0, len(lines) - 1))
        kind = data.draw(st.sampled_from(["drop", "cut", "value", "double", "text"]))
        if kind == "drop":
            lines[k] = ""
        elif kind == "cut":
            lines[k] = lines[k][: data.draw(st.integers(0, 8))]
        elif kind == "double":
            lines.insert(k, lines[k])
        else:
            new = data.draw(st.text(max_size=8) if kind == "text" else st.integers(-5, 2**40).map(str))
            lines[k] = lines[k].partition("=")[0] + "=" + new.replace("\n", " ")
    with contextlib.suppress(UnreadableEds):
        verdict(tmp_path_factory.getbasetemp(), "\n".join(lines).encode(errors="replace").decode())
