"""Prepares what user-mode Linux boots: Debian's kernel, its modules, and caches of compiled code."""

import os
import shutil
import tempfile
from pathlib import Path

from tests.vm.prepare import FOLDER as DOWNLOADS
from tests.vm.prepare import PROJECT, Missing, fetch, in_order, older, run, search_path, warm

HERE = Path(__file__).parent
FOLDER = PROJECT / "build" / "uml"
KERNEL = FOLDER / "linux.uml"
BEYOND_AMX = FOLDER / "xstate.so"
MODULES = ("overlay", "can", "can_raw", "vcan", "sch_tbf", "sch_prio", "sch_plug")
NEEDED = {"apt-get": "apt", "dpkg-deb": "dpkg", "ip": "iproute2", "tc": "iproute2"}


def prepare() -> None:
    needed = NEEDED | ({"gcc": "gcc libc6-dev"} if amx() else {})
    if lacking := {package for tool, package in needed.items() if not shutil.which(tool, path=search_path())}:
        raise Missing(f"apt-get install {' '.join(sorted(lacking))}")
    for folder in (DOWNLOADS, FOLDER):
        folder.mkdir(parents=True, exist_ok=True)
    if older(KERNEL, [HERE / "prepare.py"]):
        unpack()
    if amx() and older(BEYOND_AMX, [HERE / "xstate.c"]):
        run(["gcc", "-O2", "-shared", "-fPIC", "-o", str(BEYOND_AMX), str(HERE / "xstate.c")])
    warm(["tests/system"])


def amx() -> bool:
    """Returns whether the processor has registers that user-mode Linux 6.1 has no room for."""
    return "amx_tile" in Path("/proc/cpuinfo").read_text()


def unpack() -> None:
    """Unpacks kernel, modules and busybox; the kernel last, since its age tells whether all is there."""
    with tempfile.TemporaryDirectory(dir=FOLDER) as name:
        for package in ("user-mode-linux", "busybox-static"):
            run(["dpkg-deb", "--extract", str(fetch(package)), name])
        shutil.rmtree(FOLDER / "modules", ignore_errors=True)
        (FOLDER / "modules").mkdir()
        for number, module in enumerate(in_order(Path(name).glob("usr/lib/uml/modules/**/*.ko"), MODULES)):
            shutil.copy(module, FOLDER / "modules" / f"{number:02}-{module.name}")
        shutil.copy(Path(name) / "bin/busybox", FOLDER / "busybox")
        shutil.copy(Path(name) / "usr/bin/linux.uml", FOLDER / "new")
        os.utime(FOLDER / "new")
        (FOLDER / "new").replace(KERNEL)
