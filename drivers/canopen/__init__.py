"""A CANopen master for many two-state boards: pure state machines, and `bus`, the only module with I/O."""
