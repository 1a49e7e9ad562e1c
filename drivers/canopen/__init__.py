"""A CANopen master for many two-state boards: pure state machines. Only `wire.bus` does I/O."""
