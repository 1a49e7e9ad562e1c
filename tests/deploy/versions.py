"""Writes deploy/versions.txt, the lock of what a robot installs, from what is installed here. make lock

A line is a requirement of pip. Its comment names the parts that need the package; without a comment all need it.
"""

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.keys import DEPLOY

PATH = DEPLOY / "versions.txt"
HEAD = "# The versions on robots and in tests, written by: make lock\n"
PARTS = ("panel", "pictures", "recorder", "ros2")  # that install.sh can leave out
PYTHONS = ("3.11", "3.12", "3.13")  # no wheel of backports-zstd is for 3.14, which does not need it
PROCESSORS = ("x86_64", "aarch64")
UNUSED = {("filterpy", "matplotlib")}  # required by its metadata; only its examples import it


def needed(package: str, extra: str) -> Iterator[Requirement]:
    """Yields what a package requires on any supported robot."""
    for requirement in map(Requirement, requires(package) or ()):
        robots = (
            {"python_version": python, "python_full_version": f"{python}.0", "platform_machine": processor}
            for python in PYTHONS
            for processor in PROCESSORS
        )
        marker = requirement.marker
        if (package, requirement.name) not in UNUSED and (
            marker is None or any(marker.evaluate({**robot, "extra": extra}) for robot in robots)
        ):
            yield requirement


def closure(extra: str) -> set[str]:
    """Returns the packages that hyperbit with an extra needs, without hyperbit."""
    found, waiting = set[str](), [("hyperbit", extra)]
    done = set[tuple[str, str]]()
    while waiting:
        package, extra = waiting.pop()
        if (package, extra) in done:
            continue
        done.add((package, extra))
        for requirement in needed(package, extra):
            name = canonicalize_name(requirement.name)
            found.add(name)
            waiting += [(name, ""), *((name, more) for more in requirement.extras)]
    return found


def text() -> str:
    base, parts = closure(""), {part: closure(part) for part in PARTS}
    lines = list[str]()
    for package in sorted(base.union(*parts.values())):
        users = [] if package in base else [part for part in PARTS if package in parts[part]]
        try:
            lines.append(" ".join([f"{package}=={version(package)}", *(["", "#", *users] if users else [])]))
        except PackageNotFoundError:
            raise SystemExit(f"{package} is needed on some robots, and not installed here") from None
    return HEAD + "".join(f"{line}\n" for line in lines)


if __name__ == "__main__":
    PATH.write_text(text())
