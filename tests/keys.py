"""Certificates for tests, made by deploy/certificates.sh itself."""

import shutil
import subprocess
from pathlib import Path

DEPLOY = Path(__file__).parents[1] / "deploy"
SCRIPT = DEPLOY / "certificates.sh"


def made() -> bool:
    return shutil.which("openssl") is not None


def certificates(folder: Path, *hosts: str, clients: tuple[str, ...] = ("operator", "viewer")) -> Path:
    """Makes a folder of an authority's, a daemon's and clients' certificates."""
    for words in (("daemon", *(hosts or ("localhost",))), ("client", *clients)):
        subprocess.run([SCRIPT, folder, *words], check=True, capture_output=True)
    return folder


def openssl(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["openssl", *words], capture_output=True, text=True)
