"""What holds for the tests of kernels."""

from collections.abc import Iterator

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """Nothing is protected: infinities and NaN are values, and the generator counts modulo 2**64.

    Compiled kernels say nothing of it; with the JIT off numpy would.
    """
    with np.errstate(all="ignore"):
        yield
