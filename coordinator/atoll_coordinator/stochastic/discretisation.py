"""What a step of a process is."""

from typing import Literal

Discretisation = Literal["local linearisation", "Euler-Maruyama"]
"""What a step is: that of the process in time, or of the numerical method of this name."""
