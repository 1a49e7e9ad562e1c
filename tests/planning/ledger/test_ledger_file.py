"""The file of the ledger: damage, deletion, a full disk, earlier versions, another process, its folder."""

import shutil
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from hyperbit.controller.host.keeper import FileInUse
from hyperbit.controller.planning import ledger_file
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity
from hyperbit.controller.planning.ledger import Ledger
from hyperbit.controller.planning.ledger_file import counted, default_path, owed, read
from tests.planning.ledger.records import NAMES, REACHED, SOON, accepted, configuration_text, ended, statuses
from tests.waiting import eventually


def test_a_file_that_is_no_ledger_is_moved_aside_and_the_counts_come_from_the_executor(path: Path) -> None:
    path.parent.mkdir()
    path.write_text("a letter, far longer than the head of any database would be" * 20)
    ledger = Ledger(path, NAMES, write_every=SOON)
    eventually(lambda: ledger.damage)
    assert ledger.known == (0, 0, 0)
    ledger.counts([5, 6, 7])
    assert [fault.code for fault in ledger.faults()] == ["ledger-damaged"]
    ledger.close()
    (aside,) = path.parent.glob("*.damaged-*")
    assert aside.read_text().startswith("a letter")
    assert read(path)[0] == {"1.left": 5, "1.diagonal": 6, "1.right": 7}


def test_bytes_damaged_while_it_is_open_lose_no_count(path: Path) -> None:
    ledger = Ledger(path, NAMES, write_every=SOON)
    ledger.counts([3, 0, 3])
    eventually(lambda: configuration_text(path)[0] == {"1.left": 3, "1.right": 3})
    for part in path.parent.glob(f"{path.name}*"):
        if part.suffix != ".lock":
            part.write_bytes(b"\x5a" * part.stat().st_size)
    ledger.counts([4, 0, 3])
    eventually(lambda: configuration_text(path)[0] == {"1.left": 4, "1.right": 3})
    ledger.close()
    assert ledger.damage
    assert list(path.parent.glob("*.damaged-*"))


def test_a_damaged_file_loses_no_result_that_is_owed(path: Path) -> None:
    ledger = Ledger(path, NAMES, write_every=SOON)
    for k in range(3):
        ledger.record(accepted(k, f"goal {k}"))
    ledger.record(ended(0))
    ledger.close()
    content = bytearray(path.read_bytes())
    content[4096:8192] = b"\x5a" * 4096  # the table of the counts
    path.write_bytes(content)
    again = Ledger(path, NAMES, write_every=SOON)
    eventually(lambda: again.damage)
    again.record(ended(1))
    again.close()
    assert statuses(path) == [("goal 2", None), ("goal 1", "succeeded")]


@pytest.mark.parametrize("what", ["the file", "the folder", "nothing, it is moved"])
def test_a_file_that_is_gone_is_made_again_with_all_counts_and_owed_goals(
    path: Path, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    ledger = Ledger(path, NAMES)  # of itself it writes counts every 5 s only
    ledger.record(accepted(1, "running"))
    ledger.record(accepted(2, "over"))
    ledger.record(ended(2))
    ledger.counts([3, 0, 3])
    eventually(lambda: len(configuration_text(path)[1]) == 2 and configuration_text(path)[0])
    if what == "the folder":
        shutil.rmtree(path.parent)
    for part in path.parent.glob(f"{path.name}*"):
        if part.suffix != ".lock":
            part.rename(path.parent.parent / part.name) if "moved" in what else part.unlink()
    eventually(lambda: configuration_text(path)[0] == {"1.left": 3, "1.right": 3})
    assert statuses(path) == [("running", None)]
    assert f"{path} was deleted or moved: a new one is begun" in caplog.text
    ledger.record(ended(1))
    ledger.close()
    assert statuses(path) == [("running", "succeeded")]
    assert ledger.faults() == ()


def test_values_of_other_types_in_the_file_are_no_counts_and_no_goals(path: Path) -> None:
    Ledger(path, NAMES).close()
    with sqlite3.connect(path) as connection:
        connection.execute("INSERT INTO switches VALUES ('1.left', 'many'), ('1.right', 7)")
        connection.execute(
            "INSERT INTO goals (id, accepted, waypoints, instance, program) VALUES (x'00', 'a', 1, 1, 1)"
        )
        connection.execute("INSERT INTO goals (id, accepted, waypoints, instance, program) VALUES ('a', 1.0, 1, 1, 2)")
    connection.close()
    ledger = Ledger(path, NAMES)
    assert (ledger.known, [*ledger.owed]) == ((0, 0, 7), [(1, 2)])
    ledger.counts([1, 1, 8])
    ledger.close()
    assert ledger.known == (1, 1, 8)


def test_a_full_disk_loses_nothing_once_there_is_room(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    schema = ledger_file.SCHEMA
    monkeypatch.setattr(ledger_file, "SCHEMA", f"PRAGMA max_page_count=6; {schema}")
    ledger = Ledger(path, NAMES, write_every=SOON)
    for number in range(200):
        ledger.record(accepted(number, f"goal {number} of a long name that takes its room {'x' * 80}"))
    ledger.counts([0, 1, 0])
    (fault,) = eventually(ledger.faults)
    assert (fault.code, "full" in fault.message) == ("ledger-unwritten", True)
    monkeypatch.setattr(ledger_file, "SCHEMA", f"PRAGMA max_page_count=100000; {schema}")
    eventually(lambda: not ledger.faults())
    ledger.close()
    assert read(path)[0] == {"1.diagonal": 1}
    assert len(read(path)[1]) == 200


def test_text_that_has_no_utf8_is_written_out(ledger: Ledger, path: Path) -> None:
    ledger.record(accepted(1, "\udc80"))
    ledger.record(ended(1, REACHED._replace(message="\udc81")))
    ledger.close()
    assert (read(path)[1][0]["id"], read(path)[1][0]["message"]) == ("\\udc80", "\\udc81")


def test_only_the_latest_goals_are_kept(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_file, "MOST_GOALS", 10)
    for instance in range(2):
        ledger = Ledger(path, NAMES, write_every=SOON)
        for k in range(8):
            ledger.record(accepted(k, str(k), instance))
            ledger.record(ended(k, instance=instance))
        ledger.close()
    assert [goal["id"] for goal in read(path)[1]] == [*"76543210", "7", "6"]


@pytest.mark.parametrize("missing", [", program INTEGER, instance INTEGER", ", instance INTEGER"])
def test_a_ledger_of_an_earlier_version_is_taken_over(path: Path, missing: str) -> None:
    path.parent.mkdir()
    with sqlite3.connect(path) as connection:
        connection.executescript(ledger_file.SCHEMA.replace(missing, ""))
        connection.execute("INSERT INTO switches VALUES ('1.left', 5)")
        connection.execute(
            "INSERT INTO goals (id, accepted, waypoints, status, ended) VALUES ('a', 1, 1, 'aborted', 2)"
        )
        connection.execute("INSERT INTO goals (id, accepted, waypoints) VALUES ('open', 1.0, 1)")
        if "program" not in missing:
            connection.execute("CREATE INDEX unfinished ON goals (program) WHERE ended IS NULL")
            connection.execute("INSERT INTO goals (id, accepted, waypoints, program) VALUES ('7', 1.0, 1, 1)")
    connection.close()
    assert statuses(path)[-2:] == [("open", None), ("a", "aborted")]
    ledger = Ledger(path, NAMES, write_every=SOON)
    assert ledger.known == (5, 0, 0)
    assert ledger.owed == {}
    ledger.record(accepted(1, "new"))
    ledger.record(ended(1))
    ledger.close()
    assert ledger.faults() == ()
    found = statuses(path)
    assert (found[0], found[-2:]) == (("new", "succeeded"), [("open", "lost"), ("a", "aborted")])
    assert all(status == "lost" for _, status in found[1:-1])
    assert owed(path) == {}


HOLDER = """
import sys
from pathlib import Path
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Record
from hyperbit.controller.planning.ledger import Ledger

ledger = Ledger(Path(sys.argv[1]), ("1.left",), lambda number: print(number, flush=True), write_every=600.0)
ledger.counts([7])
ledger.record(Record(12, Identity(3, 1), AcceptanceEntry("a", 1.8e9, 2), None))
sys.stdin.read()
"""


def test_one_process_has_the_ledger_and_a_killed_one_frees_it_and_loses_nothing(path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(path)]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout
        assert holder.stdout.readline() == "12\n"
        with pytest.raises(FileInUse, match=f"is in use by process {holder.pid}"):
            Ledger(path, NAMES)
    finally:
        holder.send_signal(signal.SIGKILL)
        holder.communicate()
    again = Ledger(path, NAMES)
    assert again.known == (7, 0, 0)
    assert again.owed == {Identity(3, 1): AcceptanceEntry("a", 1.8e9, 2)}
    again.close()


def test_the_folder_is_that_of_systemd_or_of_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert default_path("a") == tmp_path / "hyperbit" / "a.sqlite"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/hyperbit")
    assert default_path("a") == Path("/var/lib/hyperbit/a.sqlite")
    assert default_path("a", simulated=True) == Path("/var/lib/hyperbit/simulated/a.sqlite")


def test_a_missing_ledger_is_an_error_not_made_and_no_word_in_the_log(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    with pytest.raises(sqlite3.Error):
        read(path)
    assert (counted(path), owed(path)) == ({}, {})
    assert not path.parent.exists()
    assert not caplog.records
