"""The judge of boards, buses and the CANopen master."""
