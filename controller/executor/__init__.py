"""The executor: runs motion programs on the boards, supervises them, and is the only process that moves the arm."""
