"""The boot of the boards."""
