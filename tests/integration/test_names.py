"""Any column name goes in: read, searched, printed, and parsed back by our own parser and by sympy."""

import json
from pathlib import Path

import numpy as np
import pytest
import sympy

from atoll_core.expression.text.parsing import from_infix
from tests.oracles.evaluate import evaluate
from tests.programs import done

NAMES = ("S", "I", "R", "N", "E", "beta", "θ", "lambda", "v [m/s]")


@pytest.mark.slow
def test_names_that_mean_something_elsewhere_are_names_here(tmp_path: Path) -> None:
    """Each column is used by the equation sought, so that each has to be printed and parsed."""
    rows = 60
    columns = {name: 1.0 + (np.arange(rows) * (7 + 2 * k)) % (11 + k) / 10.0 for k, name in enumerate(NAMES)}
    target = columns["S"] * columns["lambda"] - columns["θ"] * columns["v [m/s]"]
    lines = [",".join(["label", *NAMES])]
    lines += [",".join(map(repr, row)) for row in np.column_stack([target, *columns.values()]).tolist()]
    (tmp_path / "names.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["run", "names.csv", "--target", "label", "--workers", "1", "--max-epochs", "30", "--json"]
    ended = done(tmp_path, "coordinator", *words)
    assert ended.returncode == 0, ended.stderr
    result = json.loads(ended.stdout)
    symbols = result["symbols"]
    assert {name: symbols[name] for name in NAMES[:7]} == dict(zip(NAMES[:7], NAMES[:7], strict=True))
    assert set(symbols) >= {"S", "lambda", "v"}
    assert symbols["lambda"] != "lambda"
    equation = result["equations"][0]
    assert equation["converged"]
    inputs = {symbols[name.split(" ")[0]]: values for name, values in columns.items()}
    program = from_infix(equation["expression"], tuple(inputs))
    ours = [evaluate(program, row) for row in np.column_stack(list(inputs.values())).tolist()]
    assert ours == pytest.approx(target.tolist(), abs=1e-6)
    local = {symbol: sympy.Symbol(symbol) for symbol in symbols.values()}
    parsed = sympy.parse_expr(equation["expression"], local_dict=local)
    assert {str(symbol) for symbol in parsed.free_symbols} <= set(symbols.values())
    first = {sympy.Symbol(name): float(values[0]) for name, values in inputs.items()}
    assert float(parsed.subs(first)) == pytest.approx(float(target[0]), abs=1e-6)
