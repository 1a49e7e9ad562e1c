"""Unmet needs of boards according to their EDS: that of the simulated board, with changes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers.canopen.layout import lay_out
from drivers.canopen.tools.eds_check import Eds, UnreadableEds, lacks
from drivers.canopen.wiring import BusSettings, Channel, NodeSettings, Timing, Wiring
from drivers.simulation.dictionary import EDS

BUS = BusSettings("can0", "none", "can0")


def found(tmp_path: Path, *changes: tuple[str, str], **options: object) -> list[str]:
    """Returns the unmet needs of board 5 after changes of the EDS: section and field, or a removed section."""
    text = EDS.read_text()
    for section, change in changes:
        start = text.index(f"[{section}]")
        end = text.index("\n[", start)
        part = text[start:end]
        field, _, _ = change.partition("=")
        part = re.sub(rf"^{field}=.*$", change, part, count=1, flags=re.MULTILINE) if change else ""
        text = text[:start] + part + text[end:]
    path = tmp_path / "board.eds"
    path.write_text(text)
    channels = options.pop("channels", (Channel("a", "can0", 5, 3, 2),))
    wiring = Wiring((BUS,), channels, **options)
    [board] = lay_out(wiring).boards
    return [str(lack) for lack in lacks(Eds(path, 5), board, Timing(), wiring.error_state)]


def test_the_simulated_board_lacks_nothing(tmp_path):
    assert found(tmp_path) == []
    assert found(tmp_path, on_loss="contract") == []
    assert found(tmp_path, channels=(Channel("a", "can0", 5, 63, 63),), shared_rpdo=True) == []


@pytest.mark.parametrize(
    ("section", "change", "sentence"),
    [
        ("1000", "DefaultValue=0x000F0191", None),
        ("1000", "DefaultValue=0x00030192", "1000h sub 0 (device type): the EDS says 00030192h; profile 0191h (CiA"),
        ("6200sub1", "AccessType=wo", "6200h sub 1 (outputs 0 to 7): the EDS says AccessType=wo, PDOMapping=1"),
        ("1016sub1", "AccessType=ro", "1016h sub 1 (heartbeat of the master): the EDS says AccessType=ro"),
        ("1017", "", "1017h sub 0 (period of its heartbeat): the EDS says nothing of it; 0064h is needed; or node"),
        ("6206sub1", "AccessType=ro", "6206h sub 1 (error mode): the EDS says AccessType=ro, PDOMapping=0, Default"),
        ("1005", "DefaultValue=0x85", None),
        ("1400sub2", "AccessType=const", None),
        ("1800sub2", "DefaultValue=1", None),
        ("1600sub0", "AccessType=ro", None),  # what it maps as delivered suffices
    ],
)
def test_each_lack_is_told_with_what_is_needed(tmp_path, section, change, sentence):
    told = found(tmp_path, (section, change))
    if sentence is None:
        assert told == []
    else:
        assert len(told) == 1
        assert told[0].startswith(sentence)


def test_a_value_that_is_delivered_wrong_and_read_only_is_a_lack(tmp_path):
    [told] = found(tmp_path, ("1005", "AccessType=const"), ("1005", "DefaultValue=0x85"))
    assert told == (
        "1005h sub 0 (COB-ID of SYNC): the EDS says AccessType=const, PDOMapping=0, DefaultValue=0x85;"
        " it must be writable, for 00000080h is needed"
    )


def test_a_mapping_that_is_fixed_and_carries_nothing_is_a_lack(tmp_path):
    changes = [("1600sub0", "AccessType=const"), ("1600sub0", "DefaultValue=0")]
    [told] = found(tmp_path, *changes)
    assert told.startswith("1600h sub 0 (mapping): the EDS says AccessType=const, PDOMapping=0, DefaultValue=0x0;")
    assert told.endswith("so it must be writable, for 62000108h")


def test_outputs_that_cannot_be_mapped_are_a_lack(tmp_path):
    changes = [("1600sub0", "DefaultValue=0"), ("6200sub1", "PDOMapping=0")]
    assert found(tmp_path, *changes) == [
        "6200h sub 1: the EDS says AccessType=rww, PDOMapping=0, DefaultValue=0x0; RPDO1 must map it: PDOMapping=1"
    ]


def test_a_board_without_an_error_mode_needs_a_word_in_the_file(tmp_path):
    without = [("6206", ""), *((f"6206sub{k}", "") for k in range(9))]
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
    nodes = (NodeSettings("can0", 5, product=7),)
    [told] = found(tmp_path, nodes=nodes)
    assert told == "1018h sub 2 (product): the EDS says 00000191h; the arm's file says 00000007h"
    told = found(tmp_path, channels=(Channel("a", "can0", 5, 64, None),))
    assert told[0] == "6200h sub 9 (outputs 64 to 71): the EDS says nothing of it; the wiring uses outputs there"


@pytest.mark.parametrize("text", ["", "no EDS at all", "[1000]\nParameterName=x\n", "\0" * 100])
def test_what_is_no_eds_is_refused(tmp_path, text):
    path = tmp_path / "x.eds"
    path.write_text(text)
    with pytest.raises(UnreadableEds):
        Eds(path, 5)
    with pytest.raises(UnreadableEds, match="No such file"):
        Eds(tmp_path / "none.eds", 5)
