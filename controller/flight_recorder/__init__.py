"""The flight recorder of the two pure cores: planner and executor."""

from hyperbit.controller.flight_recorder.recorder import FlightRecorder, Label

__all__ = ["FlightRecorder", "Label"]
