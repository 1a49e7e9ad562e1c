"""The flight recorder of the two pure cores: planner and executor."""

from controller.flight_recorder.recorder import FlightRecorder, Label

__all__ = ["FlightRecorder", "Label"]
