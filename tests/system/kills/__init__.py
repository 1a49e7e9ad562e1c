"""Kills of planner and executor at chosen steps of the planner: `python -m tests.system.kills --help`."""
