"""The drawings of the pages say what hyperbit computes with."""

from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from hyperbit.controller.armfile.terminals import owned_terminals
from hyperbit.controller.pictures import explained, module_plots, wiring_plots

ROOT = Path(__file__).parents[2]


def texts_of(figure: Figure) -> str:
    return "\n".join(text.get_text() for axes in figure.axes for text in (axes.title, *axes.texts))


def test_all_drawings_are_written(tmp_path):
    explained.draw(tmp_path)
    for name in ("modules", "notation", "wiring"):
        with Image.open(tmp_path / f"{name}.png") as own, Image.open(ROOT / "deploy" / f"{name}.png") as shipped:
            assert own.size == shipped.size, f"python -m hyperbit.controller.pictures.explained deploy: {name} is old"


def test_the_wiring_shows_each_terminal_once_and_what_it_does():
    settings = explained.example()
    boards = wiring_plots.wired(settings)
    pins = [pin for owners in boards.values() for owner in owners for pin in owner.pins]
    assert sorted(pin.terminal for pin in pins if pin.terminal) == sorted(
        it.terminal for it in owned_terminals(settings)
    )
    assert list(boards) == [("can0", 1), ("can0", 9)]
    said = {owner.name: [pin.text for pin in owner.pins] for owner in boards["can0", 1]}
    assert said["1.diagonal"][:2] == ["extends, on for 50 ms only", "contracts, on for 50 ms only; never both on"]
    assert said["1.right"] == ["extends", "a spring contracts"]
    assert [owner.name for owner in boards["can0", 9]] == ["1.right", "interlock gate"]


def test_each_type_and_corner_is_named(monkeypatch, tmp_path):
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    module_plots.save_types(tmp_path)
    module_plots.save_notation(tmp_path)
    types, notation = map(texts_of, drawn)
    assert all(word in types for word in ("vgt", "revolute", "prismatic", "platform", "transforms", "left", "diagonal"))
    assert {"A", "B", "C", "D"} <= set(types.split("\n"))
    assert "module 2: digit 6 = 110\nleft extended, diagonal extended, right contracted" in notation


def test_the_page_has_the_wiring_that_is_drawn():
    assert explained.EXAMPLE in (ROOT / "controller/pictures/README.md").read_text()
