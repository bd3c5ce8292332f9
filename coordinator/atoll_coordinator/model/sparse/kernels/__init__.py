"""Compiled loops of sparse regression: ``elimination`` (integrals over windows, least squares, terms left out)."""
