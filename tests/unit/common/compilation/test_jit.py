"""Machine code is found by what the sources say, not by where they lie or when they were written."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from atoll_core.compilation.cache import WORKER, cache_directory, kernel_files, packages_compiled_into
from atoll_core.compilation.jit import IS_COMPILED, entry_point, kernel

KERNELS = """
import numpy
from atoll_core.compilation.jit import allocating_kernel, kernel

@kernel
def double(x):
    return FACTOR * x

@allocating_kernel
def numbers(count):
    return numpy.arange(count)
"""
USE = """
import numba, place
print(place.double(2.0), sum(place.double._cache_hits.values()), numba.config.CACHE_DIR)
"""


def run(folder: Path, factor: float, cache: Path, program: str = USE) -> list[str]:
    """Call a kernel that stands in a module of `folder`; return its value, and how many kernels were loaded."""
    folder.mkdir(exist_ok=True)
    (folder / "place.py").write_text(KERNELS.replace("FACTOR", str(factor)))
    environment = {**os.environ, "ATOLL_KERNEL_CACHE": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.mark.slow
@pytest.mark.skipif(not IS_COMPILED, reason="kernels are interpreted")
def test_a_copy_of_the_sources_elsewhere_finds_the_machine_code(tmp_path: Path) -> None:
    assert run(tmp_path / "one", 2.0, tmp_path / "cache") == ["4.0", "0"]
    assert run(tmp_path / "other", 2.0, tmp_path / "cache") == ["4.0", "1"]


LOAD = """
import sys
import place
print(place.double(2.0), place.numbers(3).tolist(), "numba.np.linalg" in sys.modules)
"""


@pytest.mark.slow
@pytest.mark.skipif(not IS_COMPILED, reason="kernels are interpreted")
def test_machine_code_is_loaded_without_what_compiling_needs(tmp_path: Path) -> None:
    """Numba's knowledge of Python and numpy takes as long to load as all kernels."""
    folder = tmp_path / "one"
    assert run(folder, 2.0, tmp_path / "cache", LOAD) == ["4.0", "[0,", "1,", "2]", "True"]
    assert run(folder, 2.0, tmp_path / "cache", LOAD) == ["4.0", "[0,", "1,", "2]", "False"]


STORED = """
import os, pathlib, pickle
import llvmlite.binding, place
place.double(2.0)
(stored,) = pathlib.Path(os.environ["ATOLL_KERNEL_CACHE"]).glob("place-*/*.nbc")
(_, _, (machine_code, llvm_code)), *_ = pickle.loads(stored.read_bytes())
functions = [each for each in llvmlite.binding.parse_bitcode(llvm_code).functions if not each.is_declaration]
print(len(machine_code) > 1000, len(functions) > 0)
print(*{str(one).strip() for each in functions for block in each.blocks for one in block.instructions})
"""


@pytest.mark.slow
@pytest.mark.skipif(not IS_COMPILED, reason="kernels are interpreted")
def test_machine_code_is_stored_without_the_llvm_code_of_its_functions(tmp_path: Path) -> None:
    assert run(tmp_path / "one", 2.0, tmp_path / "cache", STORED) == ["True", "True", "unreachable"]


@pytest.mark.slow
@pytest.mark.skipif(not IS_COMPILED, reason="kernels are interpreted")
def test_sources_that_say_something_else_are_compiled(tmp_path: Path) -> None:
    assert run(tmp_path / "one", 2.0, tmp_path / "cache") == ["4.0", "0"]
    assert run(tmp_path / "one", 3.0, tmp_path / "cache") == ["6.0", "0"]


def test_each_program_has_a_folder_and_shares_what_both_stand_on() -> None:
    assert packages_compiled_into("atoll_core") == ("atoll_core",)
    assert packages_compiled_into("atoll_coordinator") == ("atoll_core", "atoll_coordinator")
    folders = {cache_directory(name) for name in ("atoll_core", "atoll_coordinator", "atoll_island_worker")}
    assert len(folders) == 3


@kernel
def halved(x: float) -> float:
    return 0.5 * x


def test_an_entry_point_is_the_kernel_for_those_types():
    assert entry_point(halved, 1.0)(3.0) == halved(3.0) == 1.5


def negative_indices(source: str) -> list[int]:
    """Return the lines with an index that is a negative number."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Subscript)
        for part in (node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice])
        if isinstance(part, ast.UnaryOp) and isinstance(part.op, ast.USub)
    ]


def test_kernels_of_the_search_have_no_negative_indices() -> None:
    """They are compiled without the code that makes a negative index count from the end."""
    assert negative_indices("a[-1]") == negative_indices("a[0, -i]") == [1]
    for file in kernel_files(WORKER):
        tree = ast.parse(file.read_text("utf-8"))
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef) and function.decorator_list:
                assert not negative_indices(ast.unparse(function)), f"{file.name}: {function.name}"


@pytest.mark.slow
@pytest.mark.skipif(not IS_COMPILED, reason="kernels are interpreted")
def test_other_functions_are_compiled_with_negative_indices() -> None:
    numbers = np.arange(3.0)

    def last(values: np.ndarray, index: int) -> float:
        return float(values[index])

    assert kernel(last)(numbers, -1) == numba.njit(last)(numbers, -1) == 2.0
