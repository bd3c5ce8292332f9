"""The exit codes of the program; those of errors are in `atoll.errors`."""

from typing import Final

DONE: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
TARGET_MISSED: Final = 4
INTERRUPTED: Final = 130
