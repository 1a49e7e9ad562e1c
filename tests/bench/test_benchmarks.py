"""The modules of the benchmarks can be imported, and `make test` compiles their kernels before the tests."""

import importlib
import re

import pytest

from tests import kernels

FILES = sorted((kernels.ROOT / "tests" / "benchmarks").rglob("*.py"))


@pytest.mark.parametrize("name", [".".join(path.relative_to(kernels.ROOT).with_suffix("").parts) for path in FILES])
def test_a_module_can_be_imported(name: str) -> None:
    importlib.import_module(name)


def test_kernels_of_the_tests_and_of_the_benchmark_are_compiled_beforehand() -> None:
    files = [path for path in (*FILES, *(kernels.ROOT / "controller" / "bench").rglob("*.py"))]
    compiling = [
        path.relative_to(kernels.ROOT) for path in files if re.search(r"^@(njit|kernel)\(", path.read_text(), re.M)
    ]
    names = {".".join(path.with_suffix("").parts) for path in compiling}
    names = {name if name.startswith("tests.") else f"hyperbit.{name}" for name in names}
    proofs = {name for name in names if name.startswith("tests.benchmarks.proofs.")}  # compiled by a proof
    assert names - proofs | {"tests.benchmarks.proofs.kernels"} == kernels.bench().keys() | kernels.TESTS.keys()
