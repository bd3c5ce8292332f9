"""Marquardt's damping of a least-squares step, of the regression and of multiple shooting: numerics alone."""

from typing import Final

FIRST_DAMPING: Final = 1e-3
"""Of the first step; a step that fails takes ten times as much, one that does not a tenth."""

LEAST_DAMPING: Final = 1e-12
"""Below, a step is Newton's."""

MOST_DAMPING: Final = 1e9
"""A fit whose steps all fail up to here ends."""
