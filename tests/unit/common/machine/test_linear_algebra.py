"""Products of matrices come out alike on all processors of a kind."""

import os
import subprocess
import sys

import pytest

from atoll_core.machine.linear_algebra import CORE_TYPES, use_common_instructions

PROGRAM = """
import hashlib, os, sys
from atoll_core.machine.linear_algebra import use_common_instructions
if sys.argv[1] == "common":
    use_common_instructions(os.environ)
import numpy as np
matrix = np.random.default_rng(1).standard_normal((60, 61))
product = matrix @ matrix.T
print(hashlib.sha256(product.tobytes() + np.linalg.eigh(product)[1].tobytes()).hexdigest())
"""


def digest(how: str, **environment: str) -> str:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    command = [sys.executable, "-c", PROGRAM, how]
    return subprocess.run(command, env=plain | environment, capture_output=True, text=True, check=True).stdout


def test_the_kernels_are_those_that_all_processors_of_a_kind_have() -> None:
    environment: dict[str, str] = {}
    use_common_instructions(environment, "AMD64")
    assert environment == {"OPENBLAS_CORETYPE": "Nehalem", "OPENBLAS_NUM_THREADS": "1"}
    own = {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "2"}
    use_common_instructions(own, "x86_64")
    assert own == {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "2"}
    other: dict[str, str] = {}
    use_common_instructions(other, "riscv64")
    assert other == {"OPENBLAS_NUM_THREADS": "1"}


@pytest.mark.skipif(not CORE_TYPES.keys() & {os.uname().machine}, reason="OpenBLAS chooses for this kind of processor")
def test_products_are_those_of_the_common_kernels() -> None:
    assert digest("common") == digest("own", OPENBLAS_CORETYPE="Nehalem", OPENBLAS_NUM_THREADS="1")
    assert digest("common", OPENBLAS_CORETYPE="Prescott") != digest("common"), "kernels can be told apart"
