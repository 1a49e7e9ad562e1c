"""The certificates of deploy/certificates.sh, inspected with openssl."""

import subprocess
from pathlib import Path

import pytest

from tests.keys import SCRIPT, certificates, made, openssl

pytestmark = pytest.mark.skipif(not made(), reason="openssl is missing")


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    return certificates(tmp_path / "keys", "robot.local", "192.168.10.2")


def refusal(folder: Path, *words: str) -> str:
    ended = subprocess.run([SCRIPT, folder, *words], capture_output=True, text=True)
    assert ended.returncode == 1
    return ended.stderr


def names(keys: Path) -> set[str]:
    return {str(path.relative_to(keys)) for path in keys.rglob("*")}


def test_only_the_owner_reads_them(keys: Path) -> None:
    for path in [keys, *keys.rglob("*")]:
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path


def test_each_serves_its_purpose_and_no_other(keys: Path) -> None:
    for name, purpose, other in (("daemon", "sslserver", "sslclient"), ("operator", "sslclient", "sslserver")):
        check = ["verify", "-x509_strict", "-CAfile", str(keys / name / "ca.pem")]
        certificate = str(keys / name / "certificate.pem")
        assert openssl(*check, "-purpose", purpose, certificate).returncode == 0
        assert openssl(*check, "-purpose", other, certificate).returncode != 0


def test_the_daemons_is_for_its_hosts(keys: Path) -> None:
    certificate = ["x509", "-noout", "-in", str(keys / "daemon" / "certificate.pem")]
    for host in ("robot.local", "localhost"):
        assert "does match" in openssl(*certificate, "-checkhost", host).stdout
    for address in ("192.168.10.2", "127.0.0.1"):
        assert "does match" in openssl(*certificate, "-checkip", address).stdout
    assert "NOT match" in openssl(*certificate, "-checkhost", "other.local").stdout
    assert '"tls/robot.local:7447"' in (keys / "operator" / "zenoh.json5").read_text()


def test_they_end(keys: Path) -> None:
    for name, days in (("ca", 3650), ("daemon", 730), ("operator", 365)):
        lasts = ["x509", "-noout", "-in", str(keys / name / "certificate.pem"), "-checkend"]
        assert openssl(*lasts, str((days - 1) * 86400)).returncode == 0
        assert openssl(*lasts, str(days * 86400)).returncode == 1


def test_nothing_is_overwritten(keys: Path) -> None:
    before = {path: path.read_bytes() for path in keys.rglob("*") if path.is_file()}
    assert "operator exists" in refusal(keys, "client", "operator")
    assert "daemon exists" in refusal(keys, "daemon", "robot.local")
    assert {path: path.read_bytes() for path in keys.rglob("*") if path.is_file()} == before


def test_a_failure_leaves_no_partial_files(keys: Path) -> None:
    (keys / "daemon").rename(keys / "old")
    before = names(keys)
    assert "bad ip address" in refusal(keys, "daemon", "999.1.1.1")
    (keys / "ca" / "key.pem").write_text("no key")
    assert "ca/key.pem" in refusal(keys, "daemon", "robot.local")
    assert names(keys) == before


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("client", "../x"), "'../x' is no name"),
        (("client", "ca"), "'ca' is no name"),
        (("client", "a/CN=b"), "is no name"),
        (("daemon", "a,IP:1.2.3.4"), "is neither a host name nor an IPv4 address"),
        (("daemon", "fe80::1"), "is neither a host name nor an IPv4 address"),
        (("client", "anna"), "make the daemon's certificate first"),
        (("clients", "anna"), "neither daemon nor client"),
        (("daemon",), "usage"),
    ],
)
def test_invalid_names_are_refused(tmp_path: Path, words: tuple[str, ...], sentence: str) -> None:
    assert sentence in refusal(tmp_path / "keys", *words)
    assert not (tmp_path / "keys").exists() or not names(tmp_path / "keys")
