"""Writes the drawings of the pages: python -m hyperbit.controller.pictures.explained FOLDER."""

import sys
from pathlib import Path

import msgspec
import yaml

from hyperbit.controller.armfile.settings import ArmSettings
from hyperbit.controller.pictures import module_plots, wiring_plots

# The board of the page on drawings: each kind of actuator, and an interlock.
EXAMPLE = """\
buses: [{name: can0, channel: can0}]
actuators:
  - {module: 1, actuator: left, bus: can0, node: 1, output: 0, input: 0, input_contracted: {bit: 1, inverted: true}}
  - {module: 1, actuator: diagonal, bus: can0, node: 1, output: 2, output_off: 3, pulse: 0.05, input: 2}
  - {module: 1, actuator: right, bus: can0, node: 1, output: {bit: 4, inverted: true}, input: {bit: 5, board: can0/9}}
interlocks:
  gate: {bus: can0, node: 9, input: 0, inverted: true}
"""
REST = {
    "name": "wired",
    "tolerance": {"position": 0.01},
    "modules": [{"type": "vgt", "width": 0.2, "lengths": [0.2, 0.25]}],
}


def example() -> ArmSettings:
    """Returns an arm with the wiring of EXAMPLE."""
    return msgspec.convert({**REST, **yaml.safe_load(EXAMPLE)}, ArmSettings)


def draw(folder: Path) -> None:
    """Writes modules.png, notation.png and wiring.png into a folder."""
    module_plots.save_types(folder / "modules.png")
    module_plots.save_notation(folder / "notation.png")
    wiring_plots.save(folder / "wiring.png", example())


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
