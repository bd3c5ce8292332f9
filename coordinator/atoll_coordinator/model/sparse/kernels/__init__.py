"""Compiled loops of sparse regression, see `elimination`."""
