"""`make test` compiles all kernels before the tests."""

import re

from tests import kernels


def test_kernels_of_the_tests_and_of_the_benchmark_are_compiled_beforehand() -> None:
    folders = (kernels.ROOT / "tests" / "benchmarks", kernels.ROOT / "controller" / "bench")
    files = [
        path
        for folder in folders
        for path in folder.rglob("*.py")
        if re.search(r"^@(njit|kernel)\(", path.read_text(), re.M)
    ]
    places = [".".join(path.relative_to(kernels.ROOT).with_suffix("").parts) for path in files]
    names = {place if place.startswith("tests.") else f"hyperbit.{place}" for place in places}
    proofs = {name for name in names if name.startswith("tests.benchmarks.proofs.")}  # compiled by a proof
    assert names - proofs | {"tests.benchmarks.proofs.kernels"} == kernels.bench().keys() | kernels.TESTS.keys()
