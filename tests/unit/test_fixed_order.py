"""What feeds the search or decides when it ends adds in a fixed order, and no sort leaves ties to the processor.

Numpy's reductions, its transcendental functions, BLAS and LAPACK take what the processor has, and so give other last
bits on another one; sorts that are not stable put equal values in another order. Sums here are those of `math.fsum`, of
loops in kernels, or of whole numbers.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COORDINATOR = ROOT / "coordinator/atoll_coordinator"
SPARSE = COORDINATOR / "model/sparse"
FEEDS_THE_SEARCH = [
    COORDINATOR / "data",
    COORDINATOR / "service/jobs",
    COORDINATOR / "model/cholesky.py",
    *(SPARSE / name for name in ("laws.py", "regression.py", "rows.py", "kernels")),
    *(COORDINATOR / "model/template" / name for name in ("parameter_estimates.py", "unknown_targets.py")),
    ROOT / "common/atoll_core/data",
    ROOT / "common/atoll_core/search",
    ROOT / "common/atoll_core/expression/kernels",
    ROOT / "island_worker/atoll_island_worker",
]
"""Among many variables, laws by `many_variables` decide which searches end soon, and are not among these; see
docs/reproducibility.md. Nor is the course of hidden states, which is fitted to trajectories."""

REDUCTIONS = {
    "sum", "mean", "std", "var", "dot", "prod", "cumsum", "cumprod", "average", "cov", "corrcoef", "einsum", "inner",
    "vdot", "matmul", "tensordot", "trapezoid", "convolve", "correlate", "nansum", "nanmean", "median", "nanmedian",
    "quantile", "percentile",
}  # fmt: skip
FUNCTIONS = {
    "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan", "tanh", "sinh", "cosh", "arctan",
    "arctan2", "arcsin", "arccos", "power", "float_power", "hypot", "cbrt", "interp", "polyfit", "linalg", "fft",
    "random",
}  # fmt: skip
ALLOWED = {
    ("inputs.py", "scipy"): "slopes of inputs are for simulations; the search sees inputs at rows only",
    ("matlab_child.py", "scipy"): "reads files",
    ("increments.py", "np.median"): "one or two values of those that are there, added and halved",
    ("searched_rows.py", "np.cumsum"): "adds one after another",
    ("row_means.py", "np.cumsum"): "adds one after another",
    ("measurements.py", "np.cumsum"): "of whole numbers",
    ("row_means.py", ".sum"): "of whole numbers",
    ("rows.py", "np.cumsum"): "of whole numbers",
    ("table_checks.py", ".sum"): "counts",
    ("migration.py", ".sum"): "counts",
    ("unknown_targets.py", ".sum"): "of the equations of an unknown part, one after another; and counts",
    ("unknown_targets.py", "np.cumsum"): "adds one after another",
    ("unknown_targets.py", "np.median"): "of a warning",
    ("rows.py", "scipy"): "a probability, which is compared with a level; no sum of ours depends on it",
}


def modules(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [folder]


def is_module(node: ast.expr, *names: str) -> bool:
    return isinstance(node, ast.Name) and node.id in names


def of_its_own_order(source: str) -> Iterator[str]:
    """Yield what takes sums or functions from numpy, BLAS, LAPACK or scipy."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            yield "@"
        elif isinstance(node, ast.Attribute) and is_module(node.value, "np", "numpy"):
            if node.attr in REDUCTIONS | FUNCTIONS:
                yield f"np.{node.attr}"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            if node.func.attr in REDUCTIONS and not is_module(node.func.value, "np", "numpy", "math"):
                yield f".{node.func.attr}"
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names = [getattr(node, "module", None) or "", *(name.name for name in node.names)]
            if any(name.split(".")[0] == "scipy" for name in names):
                yield "scipy"


def unstable_sorts(source: str) -> Iterator[str]:
    """Yield sorts of places whose ties come in the order that the processor's instructions leave them in."""
    for node in ast.walk(ast.parse(source)) if re.search("argsort|argpartition", source) else ():
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            kinds = [
                keyword.value.value
                for keyword in node.keywords
                if keyword.arg == "kind" and isinstance(keyword.value, ast.Constant)
            ]
            if node.func.attr == "argpartition" or (node.func.attr == "argsort" and kinds != ["stable"]):
                yield f"{node.func.attr} in line {node.lineno}"


def found_in(folder: Path) -> set[tuple[str, str]]:
    return {(path.name, what) for path in modules(folder) for what in of_its_own_order(path.read_text("utf-8"))}


@pytest.mark.parametrize("folder", FEEDS_THE_SEARCH, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_feeds_the_search_adds_in_a_fixed_order(folder: Path) -> None:
    assert modules(folder)
    assert found_in(folder) - ALLOWED.keys() == set()


@pytest.mark.slow
def test_no_exception_has_become_needless() -> None:
    assert ALLOWED.keys() - set[tuple[str, str]]().union(*map(found_in, FEEDS_THE_SEARCH)) == set()


@pytest.mark.parametrize(
    "package",
    ["common/atoll_core", "coordinator/atoll", "coordinator/atoll_coordinator", "island_worker/atoll_island_worker"],
)
def test_every_sort_of_places_is_stable(package: str) -> None:
    names = {
        str(path.relative_to(ROOT)): sorts
        for path in modules(ROOT / package)
        if (sorts := list(unstable_sorts(path.read_text("utf-8"))))
    }
    assert names == {}


def test_what_is_looked_for_is_found() -> None:
    source = "import numpy as np\nfrom scipy import special\na = b @ c\nd = np.log(e).mean() + np.sqrt(f)\n"
    assert sorted(of_its_own_order(source)) == [".mean", "@", "np.log", "scipy"]
    assert list(unstable_sorts("np.argsort(a)\na.argsort(kind='stable')\n")) == ["argsort in line 1"]
