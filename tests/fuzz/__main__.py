"""Fuzzes all targets with both engines, two at a time, and prints a table of the results.

`python -m tests.fuzz [OUT.json]` needs the extra "fuzz". No input may cause a crash, a motion or a leak; otherwise the
exit code is 1, and the failing inputs are in `fuzz-found`. Replayed inputs are not counted. Column `blocks` has the
growth of the number of allocated memory blocks, `resident` the resident memory of the process, and `seconds` processor
time, in the last line elapsed time.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tests.fuzz.readers import SAMPLES

# Runs by target and engine; one of "executor", "packets" and "board" holds many inputs. What atheris keeps is replayed.
JOBS = [
    [("executor", "atheris", 8_000), ("executor", "replay", 1_500)],
    [("goal", "atheris", 100_000), ("goal", "replay", 8_000)],
    [("arm", "atheris", 5_000), ("arm", "replay", 1_500)],
    [("executor", "hypothesis", 4_000)],
    [("packets", "atheris", 8_000), ("packets", "replay", 1_500)],
    [("setpoint", "atheris", 150_000), ("setpoint", "replay", 20_000)],
    [("board", "atheris", 20_000), ("board", "replay", 5_000)],
    [("notation", "atheris", 100_000), ("notation", "replay", 50_000)],
    [("goal", "hypothesis", 10_000)],
    [("packets", "hypothesis", 4_000)],
    [("jog", "atheris", 50_000), ("jog", "replay", 20_000)],
    [("jog", "hypothesis", 5_000)],
    [("setpoint", "hypothesis", 10_000)],
    [("arm", "hypothesis", 3_000)],
    [("notation", "hypothesis", 10_000)],
    [("measured_tip", "atheris", 50_000), ("measured_tip", "replay", 20_000)],
    [("degrade", "atheris", 50_000), ("degrade", "replay", 20_000)],
    [("obstacles", "atheris", 50_000), ("obstacles", "replay", 8_000)],
    [("measured_tip", "hypothesis", 5_000)],
    [("degrade", "hypothesis", 5_000)],
    [("obstacles", "hypothesis", 10_000)],
    [("board", "hypothesis", 4_000)],
    [("recording", "hypothesis", 1_500)],
    *([(name, "mutations", 20_000)] for name in SAMPLES),
]
LONGEST = 1800.0  # [s] for one of them
LEAK = 0.01  # share by which the blocks held may grow after a fifth of the runs
ROW = "{:12} {:11} {:>10} {:>10} {:>8} {:>8} {:>8} {:>8} {:>9}"


def attack(job: tuple[str, str, int], room: Path) -> dict[str, Any]:
    target, engine, runs = job
    out = room / f"{target}-{engine}.json"
    command = [sys.executable, "-m", "tests.fuzz.engine", target, engine, str(runs), str(out)]
    with (room / f"{target}-{engine}.log").open("w+") as log:
        subprocess.run(command, stdout=log, stderr=log, timeout=LONGEST, check=False)
        log.seek(0)
        said = log.read()
    if not out.exists():
        raise SystemExit(f"{target} by {engine} ended without figures:\n{said[-3000:]}")
    result: dict[str, Any] = {"engine": engine, **json.loads(out.read_text())}
    if result["wrong"]:
        sys.stderr.write(said[-6000:])
    return result


def row(result: dict[str, Any]) -> str:
    r = result
    cells = [f"{r['runs']:,}", f"{r['inputs']:,}", f"{r['seconds']:.0f}", r["crashes"], r["motions"]]
    judged = r["engine"] in ("replay", "")  # engines keep memory of their own
    memory = [f"{r['blocks']:+.3%}", f"{r['resident']:+.3%}"] if judged else ["", ""]
    return ROW.format(r["target"], r["engine"], *cells, *memory)


def main() -> None:
    began = time.monotonic()
    print(ROW.format("target", "engine", "runs", "inputs", "seconds", "crashes", "motions", "blocks", "resident"))
    with tempfile.TemporaryDirectory() as room, ThreadPoolExecutor(2) as two:
        results = []
        for some in two.map(lambda jobs: [attack(job, Path(room)) for job in jobs], JOBS):
            results += some
            print("\n".join(map(row, some)), flush=True)
    fresh = [r for r in results if r["engine"] != "replay"]
    total = {key: sum(r[key] for r in fresh) for key in ("runs", "inputs")}
    total |= {key: sum(r[key] for r in results) for key in ("crashes", "motions")}
    total |= {key: max(r[key] for r in results if r["engine"] == "replay") for key in ("blocks", "resident")}
    elapsed = round(time.monotonic() - began, 1)
    print(row({"target": "all", "engine": "", **total, "seconds": elapsed}))
    if len(sys.argv) > 1:
        figures = {"results": results, **total, "seconds": elapsed}
        Path(sys.argv[1]).write_text(json.dumps(figures, indent=1) + "\n")
    if total["crashes"] or total["motions"] or total["blocks"] > LEAK:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
