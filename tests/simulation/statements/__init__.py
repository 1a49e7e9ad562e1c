"""Statements on what must hold in the world, whatever the daemon decides."""
