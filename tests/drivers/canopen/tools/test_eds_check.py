"""Unmet needs of boards according to their EDS: that of the simulated board, with changes."""

from __future__ import annotations

from pathlib import Path

import pytest

from hyperbit.drivers.canopen.layout import lay_out
from hyperbit.drivers.canopen.tools.eds import Eds
from hyperbit.drivers.canopen.tools.eds_check import lacks
from hyperbit.drivers.canopen.tools.eds_file import UnreadableEds
from hyperbit.drivers.canopen.wiring import BusWiring, Channel, Interlock, NodeWiring, Timing, WatchedObject, Wiring
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.canopen.tools.changes import TEXT, both, drop, put
from tests.drivers.rig import World

BUS = BusWiring("can0", "none", "can0")


def found(tmp_path: Path, *changes: tuple[str, str], added: str = "", **options: object) -> list[str]:
    """Returns the unmet needs of board 5 after changes of the EDS: section and field, or an object to remove."""
    path = tmp_path / "board.eds"
    path.write_text(both(*(put(*it) if it[1] else drop(it[0]) for it in changes))(TEXT) + added)
    channels = options.pop("channels", (Channel("a", "can0", 5, 3, 2),))
    wiring = Wiring((BUS,), channels, **options)
    board = next(board for board in lay_out(wiring).boards if board.node == 5)
    return [str(lack) for lack in lacks(Eds(path.read_bytes(), 5), board, Timing())]


def test_the_simulated_board_lacks_nothing(tmp_path):
    assert found(tmp_path) == []
    assert found(tmp_path, on_loss="contract") == []
    assert found(tmp_path, channels=(Channel("a", "can0", 5, 63, 63),), shared_rpdo=True) == []


@pytest.mark.parametrize(
    ("it", "bit", "change", "told"),
    [
        (WatchedObject(0x1002, 0), 0, "", "1002h sub 0: the EDS says nothing of it; the board has no 1002h sub 0; an"),
        (WatchedObject(0x1001, 0), 9, "AccessType=ro", "DefaultValue=0x0; the board has 8 bits in 1001h sub 0"),
        (WatchedObject(0x1001, 0), 0, "AccessType=wo", "1001h sub 0: the EDS says AccessType=wo"),
        (WatchedObject(0x1001, 0), 7, "DefaultValue=", None),
    ],
)  # fmt: skip
def test_an_object_of_an_interlock_must_be_there_readable_and_large_enough(tmp_path, it, bit, change, told):
    lock = Interlock("supply", "can0", 5, bit, True, it)
    changes = [("1001", change)] if change else []
    lacks = found(tmp_path, *changes, interlocks=(lock,))
    assert (len(lacks), told in lacks[0]) == (1, True) if told else lacks == []


def test_all_lacks_are_told_and_not_only_the_first(tmp_path):
    changes = [("1017", "AccessType=const"), ("6206sub1", "AccessType=ro"), ("1800sub1", "AccessType=ro")]
    changes += [("1800sub1", "DefaultValue=0x700"), ("6005", "DataType=0x0006")]
    told = found(tmp_path, *changes)
    assert [lack[:11] for lack in told] == ["6005h sub 0", "1017h sub 0", "1800h sub 1", "6206h sub 1"]


def test_a_value_that_is_delivered_wrong_and_read_only_is_a_lack(tmp_path):
    [told] = found(tmp_path, ("1005", "AccessType=const"), ("1005", "DefaultValue=0x85"))
    assert told == (
        "1005h sub 0: the EDS says AccessType=const, PDOMapping=0, DataType=0x0007, DefaultValue=0x85; the board"
        " has 00000085h in 1005h sub 0 (COB-ID of SYNC); 00000080h is needed, which it refuses: attempt to write a"
        " read only object (abort 06010002h)"
    )


def test_a_shared_rpdo_needs_dummy_entries(tmp_path):
    channels = (Channel("a", "can0", 4, 0, 0), Channel("b", "can0", 5, 0, 0))
    assert found(tmp_path, channels=channels, shared_rpdo=True) == []
    [told] = found(tmp_path, ("DummyUsage", "Dummy0005=0"), channels=channels, shared_rpdo=True)
    assert told.startswith("0005h sub 0: the EDS says Dummy0005=0; RPDO1 cannot be shared with other boards")


def test_outputs_that_cannot_be_mapped_are_a_lack(tmp_path):
    changes = [("1600sub0", "DefaultValue=0"), ("6200sub1", "PDOMapping=0")]
    [told] = found(tmp_path, *changes)
    assert told.startswith("6200h sub 1: the EDS says AccessType=rww, PDOMapping=0,")
    assert told.endswith("it refuses 62000108h in 1600h sub 1: object cannot be mapped to the PDO (abort 06040041h)")


@pytest.mark.parametrize(("kind", "fits"), [("0x0005", True), ("0x0006", False)])
def test_outputs_of_a_makers_object_are_bytes(tmp_path, kind, fits):
    entry = "ParameterName=v\nObjectType=0x7\nDataType={}\nAccessType={}\nDefaultValue={}\nPDOMapping={}\n"
    head = "[2201]\nParameterName=v\nObjectType=0x8\nSubNumber=3\n"
    parts = [f"[2201sub0]\n{entry.format('0x0005', 'ro', 2, 0)}"]
    parts += [f"[2201sub{sub}]\n{entry.format(kind, 'rw', 0, 1)}" for sub in (1, 2)]
    options = {"error_state": "hold", "nodes": (NodeWiring("can0", 5, object=0x2201),)}
    told = found(tmp_path, added="\n".join(["", head, *parts]), **options)
    if fits:
        assert told == []
    else:
        assert told[0].startswith("2201h sub 1: the EDS says AccessType=rw, PDOMapping=1, DataType=0x0006")


def test_a_board_without_an_error_mode_needs_a_word_in_the_file(tmp_path):
    without = [("6206", "")]
    [told] = found(tmp_path, *without)
    assert "set boards.error_state to off, hold or device" in told
    assert found(tmp_path, *without, error_state="hold") == []
    [told] = found(tmp_path, *without, error_state="hold", on_loss="contract")
    assert "outputs must go off when the master is lost" in told
    assert found(tmp_path, *without, error_state="off", on_loss="contract") == []
    inverted = (Channel("a", "can0", 5, 3, 2, inverted=frozenset({"output"})),)
    [told] = found(tmp_path, *without, channels=inverted, error_state="off", on_loss="contract")
    assert "outputs must go off when the master is lost" in told


def test_another_device_and_outputs_that_are_not_there_are_lacks(tmp_path):
    [told] = found(tmp_path, nodes=(NodeWiring("can0", 5, product=7),))
    assert told.startswith("1018h sub 2: the EDS says AccessType=ro")
    assert "it is another device than the arm's file says" in told
    assert found(tmp_path, nodes=(NodeWiring("can0", 5, serial=7),)) == []  # only the device tells its number
    told = found(tmp_path, channels=(Channel("a", "can0", 5, 64, None),))
    assert told[0].startswith("6200h sub 0: the EDS says AccessType=")
    assert "the board has 8 bytes of outputs in 6200h; sub 9 is needed, the wiring uses it" in told[0]


@pytest.mark.parametrize("name", [name for name, one in VARIANTS.items() if one.absent and not one.changes])
def test_the_check_says_what_the_boot_says(tmp_path, name):
    """The procedures are the boot's own, so that the sentences are the same."""
    variant = VARIANTS[name]
    told = found(tmp_path, *((f"{index:04X}", "") for index in sorted(variant.absent)))
    faults = World([Channel("a", "can0", 5, 3, 2)], variants={"can0/5": variant}).boot()
    refusals = [fault.message.partition(" has no ")[2] for fault in faults]
    assert [lack.partition(" has no ")[2] for lack in told] == refusals


@pytest.mark.parametrize(
    "text", ["", "no EDS at all", "[DeviceInfo]\nVendorName=x\n", "\0" * 100, '<?xml version="1.0"?>']
)
def test_what_is_no_eds_is_refused(tmp_path, text):
    path = tmp_path / "x.eds"
    path.write_text(text)
    with pytest.raises(UnreadableEds):
        Eds(path.read_bytes(), 5)
