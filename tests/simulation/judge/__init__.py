"""The judge of the simulation: an account of the world from outside, which decides whether the daemon is right."""
