"""Each notebook beside the library's page runs, shows its pictures, and is kept without outputs."""

from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient", reason="an environment from before: make .venv/installed")
nbformat = pytest.importorskip("nbformat")

FOLDER = Path(__file__).parents[2] / "controller" / "library" / "notebooks"
# Pictures, and words of the texts and tables.
SHOWN = {
    "1_first_solve": (2, "optimal"),
    "2_own_arm": (2, "type: vgt"),
    "3_trajectory_among_obstacles": (2, "disc 'pillar'"),
    "4_workspace": (1, "of the map is left"),
    "5_calibration": (1, "held out"),
}


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", SHOWN)
def test_a_notebook_runs_and_shows_its_pictures(name: str) -> None:
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in notebook.cells)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(FOLDER)}}).execute()
    pictures, words = SHOWN[name]
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    data = [output.get("data", {}) for output in shown]
    texts = [it.get("text", "") for it in shown] + [it.get("text/html", "") + it.get("text/plain", "") for it in data]
    assert sum("image/png" in it or "<img" in it.get("text/html", "") for it in data) == pictures
    assert words in "".join(texts)


def test_each_notebook_is_tried() -> None:
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == SHOWN.keys()
