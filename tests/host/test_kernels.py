"""Which modules have kernels, in which order they are compiled, and what does without them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hyperbit.controller.host import kernels
from hyperbit.controller.manipulator import frame_kernels

TWO = """
import numpy as np
from numba import float64, int64
from hyperbit.controller.host.kernel import kernel

@kernel(float64(int64))
def allocates(n):
    return np.full(n, 2.0).sum()

@kernel(float64(int64), _nrt=False)
def calls(n):
    return allocates(n)

print(calls(3))
"""
WITHOUT = (  # what the planner's core and clients use
    *(f"hyperbit.controller.manipulator.{name}" for name in ("frames", "locked", "notation")),
    *("hyperbit.controller.motion.targets", "hyperbit.controller.motion.trajectory"),
    *("hyperbit.controller.motion.decoding.goal", "hyperbit.controller.motion.decoding.setpoint"),
    *(f"hyperbit.controller.motion.stages.{name}" for name in ("feed", "program")),
    *("hyperbit.controller.motion.tracking.bias", "hyperbit.controller.motion.tracking.tracking"),
    *("hyperbit.controller.planning.core.core", "hyperbit.controller.panel.serve"),
)


def test_modules_with_kernels_come_with_those_they_depend_on():
    found = kernels.kernels()
    assert {
        "hyperbit.controller.search.lists.matching",
        "hyperbit.controller.obstacles.scene",
        "hyperbit.controller.obstacles.collision",
    } <= found.keys()
    assert "hyperbit.controller.obstacles.collision" in found["hyperbit.controller.search.lists.matching"]
    for name, others in found.items():
        assert name not in others
        assert others <= found.keys()


def test_kernels_of_the_library_are_compiled_beforehand():
    code = "import sys, hyperbit.controller.library; print(*(n for n in sys.modules if n.startswith('hyperbit.')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    files = {name: kernels.path(name) for name in done.stdout.split()}
    needed = {name for name, file in files.items() if file.is_file() and "@kernel(" in file.read_text(encoding="utf-8")}
    assert needed <= kernels.kernels().keys()


def test_an_import_loads_no_kernel_and_a_search_few():
    code = """
import hyperbit
from hyperbit.controller.host.kernel import kernels
arm = hyperbit.Arm([hyperbit.vgt(width=0.2, lengths=(0.2, 0.25), count=2)])
assert kernels and not any(kernel.signatures for kernel in kernels)
hyperbit.Solver(arm).solve(hyperbit.Goal((0.0, 0.4)), start=arm.home)
assert any(kernel.signatures for kernel in kernels) and any(not kernel.signatures for kernel in kernels)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_call_with_other_types_is_refused():
    with pytest.raises(TypeError, match="No matching definition"):
        frame_kernels.angle_between("no frame", "no frame")


def test_a_module_is_imported_after_those_it_depends_on(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "hyperbit_first.py").write_text(f"open({str(tmp_path / 'mark')!r}, 'w').close()")
    (tmp_path / "hyperbit_second.py").write_text(f"open({str(tmp_path / 'mark')!r}).close()")
    kernels.compile_all({"hyperbit_second": {"hyperbit_first"}, "hyperbit_first": set()}, 2)
    assert not {"hyperbit_first", "hyperbit_second"} & set(sys.modules)


def test_a_module_that_cannot_be_imported_is_named():
    with pytest.raises(RuntimeError, match=r"the kernels of hyperbit\.controller\.missing cannot be compiled"):
        kernels.compile_all({"hyperbit.controller.missing": set()}, 1)


def test_indexes_of_machine_code_are_dropped(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "PACKAGE", tmp_path)
    index, code = (tmp_path / "controller" / "__pycache__" / name for name in ("a.f.nbi", "a.f.1.nbc"))
    index.parent.mkdir(parents=True)
    index.touch()
    code.touch()
    kernels.drop_indexes()
    assert (index.exists(), code.exists()) == (False, True)


def test_what_needs_no_kernel_does_not_import_numba():
    code = "import sys\nfor name in sys.argv[1:]:\n    __import__(name)\n    assert 'numba' not in sys.modules, name"
    done = subprocess.run([sys.executable, "-c", code, *WITHOUT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_kernel_that_allocates_is_compiled_by_one_that_counts_no_references(tmp_path: Path) -> None:
    """In a process of its own, which has no machine code of the two."""
    (tmp_path / "two.py").write_text(TWO)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, tmp_path / "two.py"], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout) == (0, "6.0\n"), done.stderr
