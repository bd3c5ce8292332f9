"""The exit codes of the program; those of errors are in `atoll_core.errors`."""

from typing import Final

from atoll_core.signals import INTERRUPTED as INTERRUPTED

DONE: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
TARGET_MISSED: Final = 4
