"""Frames: identifiers, buses, links and echoes."""
