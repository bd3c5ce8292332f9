"""The programs that open exports, as far as they are installed; each returns the states at the times of a model.

A program that is not there raises `Absent`.
"""

import importlib
import io
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.api.model import Model
from atoll.model.arguments import times_of
from atoll_core.data.dataset import FloatArray
from benchmarks.exports import readers


class Absent(Exception):
    """A program or a package is not installed."""


@contextmanager
def _written(name: str, text: str) -> Iterator[str]:
    """Write a file into a folder of its own, and return the folder."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / name).write_text(text, "utf-8")
        yield folder


def python(model: Model) -> FloatArray:
    """Run the module as a program of its own."""
    with _written("model.py", model.to_python()) as folder:
        return _csv(_run([sys.executable, "-W", "error", "model.py"], folder))


def c(model: Model) -> FloatArray:
    """Compile the program without a warning, and run it."""
    compiler = _found("cc")
    with _written("model.c", model.to_c()) as folder:
        strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
        _run([compiler, *strict, "-O1", "model.c", "-o", "model", "-lm"], folder)
        return _csv(_run([str(Path(folder) / "model")], folder))


def octave(model: Model) -> FloatArray:
    """Run the function by Octave."""
    program = _found("octave-cli")
    with _written("atoll_model.m", model.to_matlab()) as folder:
        return _csv(_run([program, "--no-gui", "--quiet", "--eval", "atoll_model"], folder))


def julia(model: Model) -> FloatArray:
    """Run the Julia script."""
    program = _found("julia")
    with _written("model.jl", model.to_julia()) as folder:
        return _csv(_run([program, "model.jl"], folder))


def xppaut(model: Model) -> FloatArray:
    """Run the .ode file by XPPAUT, which keeps single precision."""
    program = _found("xppaut")
    with _written("model.ode", model.to_xppaut()) as folder:
        _run([program, "model.ode", "-silent"], folder)
        return np.loadtxt(Path(folder) / "output.dat")[:, 1:]


def julia_text(model: Model) -> FloatArray:
    """Parse the Julia script by its grammar without an error, read the system and integrate it here."""
    text = model.to_julia()
    check_julia(text)
    return readers.read_julia(text).simulate(times_of(model, None))


def check_julia(text: str) -> None:
    """Parse Julia by the grammar of tree-sitter, which must find no error.

    That grammar does not know ``~`` inside a list, as ModelingToolkit writes equations; it is read as ``==``.
    """
    parser = _imported("tree_sitter").Parser(
        _imported("tree_sitter").Language(_imported("tree_sitter_julia").language())
    )
    assert not parser.parse(text.replace(" ~ ", " == ").encode()).root_node.has_error


def pymoca(model: Model) -> FloatArray:
    """Parse the Modelica model by pymoca's grammar, and integrate its syntax tree here."""
    tree = _imported("pymoca.parser").parse(model.to_modelica())
    assert tree is not None
    model_class = tree.classes["AtollModel"]
    symbols = model_class.symbols
    numbers = {name: _number(symbol) for name, symbol in symbols.items() if "parameter" in symbol.prefixes}
    states = {equation.left.operands[0].name: equation.right for equation in model_class.equations}
    start = np.array([_number(symbols[name]) for name in states])

    def rates(t: float, x: FloatArray) -> list[float]:
        names = {**numbers, "time": t, **dict(zip(states, x.tolist(), strict=True))}
        return [_value(state, names) for state in states.values()]

    return readers.integrated(rates, start, times_of(model, None))


_SIGNS: Final[dict[str, Callable[..., float]]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b=None: -a if b is None else a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "^": lambda a, b: a**b,
}


def _number(symbol: Any) -> float:
    """Return the value of a parameter, or the initial value of a state: what is said first of it."""
    return _value(symbol.class_modification.arguments[0].value.modifications[0], {})


def _value(node: Any, names: dict[str, float]) -> float:
    """Return the value of an expression of Modelica's syntax tree."""
    kind = type(node).__name__
    if kind == "Primary":
        return float(node.value)
    if kind == "ComponentRef":
        return names[node.name]
    name = node.operator if isinstance(node.operator, str) else node.operator.name
    arguments = [_value(operand, names) for operand in node.operands]
    return float(_SIGNS[name](*arguments) if name in _SIGNS else getattr(np, name)(*arguments))


def roadrunner(model: Model) -> FloatArray:
    """Check the SBML by libsbml, and simulate it by libroadrunner."""
    text = model.to_sbml()
    document = _imported("libsbml").readSBMLFromString(text)
    document.checkConsistency()
    errors = [document.getError(number) for number in range(document.getNumErrors())]
    assert not [error.getMessage() for error in errors if error.getSeverity() >= 2]
    runner = _imported("roadrunner").RoadRunner(text)
    runner.integrator.setValue("relative_tolerance", 1e-12)
    runner.integrator.setValue("absolute_tolerance", 1e-13)
    runner.integrator.setValue("maximum_num_steps", 1_000_000)
    rules = [document.getModel().getRule(number) for number in range(document.getModel().getNumRules())]
    states = [rule.getVariable() for rule in rules if rule.isRate()]
    times = times_of(model, None)
    return np.array(runner.simulate(float(times[0]), float(times[-1]), len(times), ["time", *states]))[:, 1:]


def lint_petab(folder: Path) -> None:
    """Check a PEtab problem by PEtab's own linter, which must find no error."""
    petab = _imported("petab.v1")
    problem = petab.Problem.from_yaml(str(folder / "problem.yaml"))
    assert not petab.lint_problem(problem)


PROGRAMS: Final[dict[str, Callable[[Model], FloatArray]]] = {
    "Python": python,
    "C (cc)": c,
    "MATLAB (Octave)": octave,
    "Julia (Julia)": julia,
    "Julia (grammar, read)": julia_text,
    "Modelica (pymoca)": pymoca,
    "Modelica (read)": lambda model: readers.read_modelica(model.to_modelica()).simulate(times_of(model, None)),
    "XPPAUT (read)": lambda model: readers.read_xppaut(model.to_xppaut()).simulate(times_of(model, None)),
    "XPPAUT (XPPAUT)": xppaut,
    "SBML (libroadrunner)": roadrunner,
}


def _found(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        raise Absent(name)
    return path


def _imported(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise Absent(name) from error


def _run(command: list[str], folder: str) -> str:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, env=environment)
    assert ended.returncode == 0, f"{command[0]}: {ended.stderr[-2000:]}"
    return ended.stdout


def _csv(text: str) -> FloatArray:
    return np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1)[:, 1:]
