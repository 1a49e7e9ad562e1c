"""Prepares what the virtual machine boots: Debian's kernel, an initramfs, and caches that it would fill too slowly.

python -m tests.vm.prepare [--essential]

With `--essential`, only what `python -m tests.vm.boot --essential` needs is prepared.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

PROJECT = Path(__file__).parents[2]
FOLDER = PROJECT / "build" / "vm"
HERE = Path(__file__).parent
WHEELS = FOLDER / "wheels"  # from which the robot installs, without a network
PYTHON = "/usr/bin/python3"  # the robot's
VERSION = 'import sys; print("%d.%d" % sys.version_info[:2])'
ALONE = "tests/vm"  # tests of the installed services, which need the machine for themselves
TESTS = [ALONE, "tests/system"]

# Of the kernel, in this order; modules that they depend on are added before them.
MODULES = (
    *("virtio_pci", "virtio_rng", "9pnet_virtio", "9p", "overlay"),
    *("can", "can_raw", "vcan", "sch_tbf", "sch_prio", "sch_plug"),
)
NEEDED = {
    "qemu-system-x86_64": "qemu-system-x86",
    "apt-get": "apt",
    "dpkg-deb": "dpkg",
    "/lib/systemd/systemd": "systemd",
    "udevadm": "udev",
    "ip": "iproute2",
    PYTHON: "python3-venv",
}


class Missing(Exception):
    """This computer lacks something, which the text names in one line."""


def prepare(tests: Sequence[str]) -> None:
    """Makes what is missing or out of date for tests.

    Those in tests/vm need the installed services; the others need the project's compiled kernels.
    """
    lacking = [package for tool, package in NEEDED.items() if not shutil.which(tool, path=search_path())]
    if lacking:
        raise Missing(f"apt-get install {' '.join(lacking)}")
    (FOLDER / "robot").mkdir(parents=True, exist_ok=True)
    if older(FOLDER / "initrd", [HERE / "init", HERE / "prepare.py"]):
        pack()
    parts: list[Callable[[], None]] = []
    if any(not path.startswith(ALONE) for path in tests):
        parts.append(lambda: warm(TESTS))
    sources = [HERE / "robot.sh", PROJECT / "Makefile", *installed()]
    if any(path.startswith(ALONE) for path in tests) and older(FOLDER / "robot.installed", sources):
        parts.append(install)
    with ThreadPoolExecutor() as pool:  # each compiles on one processor
        for part in [pool.submit(part) for part in parts]:
            part.result()


def search_path() -> str:
    return f"{os.environ['PATH']}:/usr/sbin:/sbin"


def older(made: Path, sources: Iterable[Path]) -> bool:
    """Returns whether a file is missing, or older than one of its sources."""
    return not made.exists() or made.stat().st_mtime < max(source.stat().st_mtime for source in sources)


def installed() -> list[Path]:
    folders = [PROJECT / name for name in (".package", "controller", "drivers", "deploy")]
    files = [path for folder in folders for path in folder.rglob("*.*") if path.parent.name != "__pycache__"]
    return [PROJECT / "pyproject.toml", *files]


def fetch(package: str) -> Path:
    """Returns the file of a package, from the folder or from Debian."""
    if not (found := sorted(FOLDER.glob(f"{package}_*.deb"))):
        say(f"fetching {package}")
        run(["apt-get", "download", package], FOLDER)
        found = sorted(FOLDER.glob(f"{package}_*.deb"))
    return found[-1]


def kernel_package() -> str:
    """Returns the name of the package that Debian's own for the newest kernel stands for."""
    if found := sorted(FOLDER.glob("linux-image-*.deb")):
        return found[-1].name.partition("_")[0]
    depends = subprocess.run(["apt-cache", "depends", "linux-image-amd64"], capture_output=True, text=True).stdout
    if not (names := re.findall(r"Depends: (linux-image-[0-9]\S*)", depends)):
        raise Missing("no package linux-image-amd64 is known: apt-get update, on Debian")
    return names[0]


def pack() -> None:
    kernel, busybox = fetch(kernel_package()), fetch("busybox-static")
    say("packing the initramfs")
    with tempfile.TemporaryDirectory(dir=FOLDER) as name:
        unpacked, tree = Path(name) / "unpacked", Path(name) / "tree"
        for package in (kernel, busybox):
            run(["dpkg-deb", "--extract", str(package), str(unpacked)])
        for directory in ("bin", "modules", "proc", "sys", "dev", "lower", "robot", "upper", "root", "project"):
            (tree / directory).mkdir(parents=True)
        (tool,) = unpacked.glob("**/bin/busybox")
        shutil.copy(tool, tree / "bin/busybox")
        shutil.copy(HERE / "init", tree / "init")
        (tree / "init").chmod(0o755)
        for number, module in enumerate(in_order(unpacked.glob("lib/modules/**/*.ko"), MODULES)):
            shutil.copy(module, tree / "modules" / f"{number:02}-{module.name}")
        (image,) = unpacked.glob("boot/vmlinuz-*")
        shutil.copy(image, FOLDER / "vmlinuz")
        files = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
        with (FOLDER / "initrd.new").open("wb") as archive:
            cpio = [str(tool), "cpio", "-o", "-H", "newc"]
            subprocess.run(cpio, input=files.encode(), stdout=archive, stderr=subprocess.DEVNULL, cwd=tree, check=True)
        (FOLDER / "initrd.new").replace(FOLDER / "initrd")


def in_order(found: Iterable[Path], names: Iterable[str]) -> list[Path]:
    """Returns the files of the named modules, each after those it depends on."""
    files = {path.stem.replace("-", "_"): path for path in found}
    order: list[Path] = []

    def add(name: str) -> None:
        path = files[name.replace("-", "_")]
        match = re.search(rb"\0depends=([^\0]*)\0", path.read_bytes())
        for needed in match[1].decode().split(",") if match and match[1] else []:
            add(needed)
        if path not in order:
            order.append(path)

    for name in names:
        add(name)
    return order


def warm(tests: Sequence[str]) -> None:
    """Fills the project's caches of bytecode and kernels, for any processor: the machine would compile for minutes."""
    say("filling the caches of compiled code")
    cache = FOLDER / "cache"
    settings = {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(cache / "numba"), "XDG_CACHE_HOME": str(cache)}
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"} | settings
    bin = Path(sys.executable).parent
    run([str(bin / "python"), "-m", "tests.vm.compile"], env=environment)
    run([str(bin / "pytest"), "--collect-only", "-qq", "-p", "no:cacheprovider", *tests], env=environment)


def install() -> None:
    if os.geteuid() != 0:
        raise Missing("root is needed to install the services: sudo make vm-test")
    say("installing the services")
    python = subprocess.run([PYTHON, "-c", VERSION], capture_output=True, text=True, check=True).stdout.strip()
    run(["make", "wheels", f"WHEELS={WHEELS}", f"ROBOT_PYTHON={python}"])
    run(["unshare", "--mount", "--net", "sh", str(HERE / "robot.sh"), str(FOLDER / "robot"), str(WHEELS)])
    (FOLDER / "robot.installed").touch()


def say(what: str) -> None:
    print(f"vm-test: {what}", flush=True)


def run(command: list[str], folder: Path = PROJECT, env: dict[str, str] | None = None) -> None:
    """Runs a command that must succeed; its output is only shown if it does not."""
    done = subprocess.run(command, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode != 0:
        raise Missing(f"`{' '.join(command)}` failed with {done.returncode}:\n{done.stdout}")


if __name__ == "__main__":
    try:
        prepare([ALONE] if "--essential" in sys.argv else TESTS)
    except Missing as error:
        sys.exit(f"vm-test: cannot run: {error}")
