"""No column is called as an exported file calls something already: its own names, keywords, macros, functions."""

import keyword
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.export.formats import LANGUAGES
from atoll.export.language import Naming
from atoll.export.languages import C
from atoll_core.expression.operators import OPERATORS
from benchmarks.exports import programs, readers
from tests.unit.library.export.exported import TIMES, difference, model, process, run_python
from tests.unit.library.model.results import constant, result

MARK = re.compile(r"zq\w*")
"""Names of columns that no language and no file has, as they are recognised in a text."""
ASIDE = {"modelica": r"annotation\(.*", "xppaut": r"@.*"}
"""Settings, whose names are no names of the model."""
SHADOWED = {"python": {"x"}, "julia": {"s"}}
"""Names that a file does not use any more where a column of that name has its value, and those local to a function."""
SCOPES = {
    "python": r"(?m)^(?=def |\S+ = )",
    "c": r"(?m)^(?=static |int |double )",
    "matlab": r"(?m)^(?=function )",
    "modelica": r"(?m)^(?=  function )|(?<=;)$(?=\n  (?:parameter|Real))",
}
"""Where the parts of a file begin that have names of their own; other formats have one set of names for all of it."""


def contents(name: str) -> list[str]:
    """Return files of a format: with constants, the time, numbers and tables as inputs, noise, and of a regression."""
    forced = model({"zqa": "-0.3*zqu*zqa + cos(t) - abs(zqb)**1.5", "zqb": "zqa/3.7 - log(zqb)"}, inputs=("zqu", "t"))
    contents = forced.result.as_dict()
    contents["equations"][0]["constants"] = [constant(-0.3, 0.1)]
    texts = [Model(contents).export(name, None, TIMES, {"zqu": 1.5})]
    if name not in ("xppaut",):
        texts.append(Model(contents).export(name, None, TIMES, {"zqu": np.sin(TIMES)}))
    if name in ("python", "julia", "xppaut"):
        noisy = process().result.as_dict()
        noisy["symbols"] = {"zqa": "zqa", "zqb": "zqb"}
        for equation in noisy["equations"]:
            for key in ("variable", "expression"):
                equation[key] = re.sub("y", "zqb", equation[key].replace("x", "zqa"))
        noisy["process"]["ensemble"]["mean"] = {"zqa": [1.0], "zqb": [0.5]}
        texts.append(Model(noisy).export(name))
    if name in ("python", "c", "julia", "matlab"):
        plain = result({"zqy": "2.5*zqa - sqrt(zqb)"}, ("zqa", "zqb"))
        plain["equations"][0] |= {"lhs": "zqy", "program": None}
        texts.append(Model(plain | {"symbols": {"zqa": "zqa", "zqb": "zqb"}}).export(name))
    return texts


def own_names(name: str) -> set[str]:
    """Return the names that the files of a format use themselves where columns have names, and their macros."""
    texts: set[str] = set()
    for text in contents(name):
        if name == "sbml":
            texts |= set(re.findall(r'\bid="(\w+)"', re.sub(r"<unitDefinition.*", "", text)))
            continue
        code = re.sub(r'"""(?:.|\n)*?"""', "", text)
        code = "\n".join(line.split(LANGUAGES[name].comment)[0] for line in code.splitlines())
        code = re.sub(ASIDE.get(name, r"\Z"), " ", code)
        code = re.sub(r'"[^"\n]*"|\'[^\'\n]*\'(?=[,;)\]:])', " ", code)
        texts |= set(re.findall(r"#define (\w+)", code))
        for part in re.split(SCOPES.get(name, r"\Z"), code):
            if re.search(rf"\b{MARK.pattern}", part):
                texts |= set(re.findall(r"(?<![\w.])[A-Za-z_]\w*", part))
    return {text for text in texts if not MARK.search(text) and not re.fullmatch(r"[cbgw]\d+(_\d+)?", text)}


def is_taken(naming: Naming, name: str) -> bool:
    """Tell whether a language gives a column of this name another one."""
    return naming.assign({name: name})[name] != name


@pytest.mark.parametrize("name", LANGUAGES)
def test_no_column_gets_a_name_that_the_file_uses_itself(name: str) -> None:
    used = own_names(name)
    assert used
    assert {name_used for name_used in used if not is_taken(LANGUAGES[name].naming, name_used)} <= SHADOWED.get(
        name, set()
    )


@pytest.mark.parametrize("name", [name for name in LANGUAGES if name != "sbml"])  # SBML has elements for functions
def test_no_column_gets_the_name_of_a_function_that_expressions_call(name: str) -> None:
    notation = LANGUAGES[name].notation
    called = {
        notation.call(operator.code)
        for operator in OPERATORS
        if operator.arity == 1 and operator.text and operator.text != "-"
    }
    called |= {notation.call(code) for code in notation.quotients}
    called |= set(re.findall(r"(?<![.\w])[a-z]\w+(?=\()", notation.power + notation.natural))
    assert [
        name_used for name_used in called if "." not in name_used and not is_taken(LANGUAGES[name].naming, name_used)
    ] == []


@pytest.mark.parametrize("name", LANGUAGES)
def test_prefixes_of_names_are_the_files_own(name: str) -> None:
    text = "\n".join(contents(name))
    prefixes = {name.removesuffix(MARK.search(name)[0]) for name in re.findall(r"\b\w+_zq\w*", text)}  # type: ignore[index]
    assert all(is_taken(LANGUAGES[name].naming, prefix + "x") for prefix in prefixes if prefix)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_no_column_gets_the_name_of_a_macro_of_c(tmp_path: Path) -> None:
    source = tmp_path / "headers.c"
    source.write_text("#include <math.h>\n#include <stdio.h>\n#include <stdlib.h>\n")
    for standard in ("c99", "gnu99"):
        said = subprocess.run(["cc", f"-std={standard}", "-dM", "-E", str(source)], capture_output=True, text=True)
        macros = re.findall(r"(?m)^#define ([A-Za-z]\w*) ", said.stdout)
        assert "NULL" in macros
        assert [macro for macro in macros if not is_taken(C.naming, macro)] == []


def hostile(name: str) -> Model:
    """Return a model whose states are called as hostile as can be to a format, each growing at a rate of its own."""
    taken = {*own_names(name), *LANGUAGES[name].naming.reserved, "SIZE", "tolerance", "nodes", "k", "i", "x"}
    words = sorted(name_used for name_used in taken if name_used.isidentifier() and not keyword.iskeyword(name_used))
    return model({word: f"-0.{place + 101}*{word}" for place, word in enumerate(words)})


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_c_compiles_with_every_such_name_and_agrees() -> None:
    contents = hostile("c")
    assert difference(programs.c(contents), contents) < 1e-8


def test_python_runs_with_every_such_name_and_agrees() -> None:
    contents = hostile("python")
    assert difference(run_python(contents.to_python())["simulate"](), contents) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "read"),
    [("xppaut", readers.read_xppaut), ("modelica", readers.read_modelica), ("julia", readers.read_julia)],
)
def test_other_files_are_read_with_every_such_name_and_agree(name: str, read: object) -> None:
    contents = hostile(name)
    assert difference(read(contents.export(name)).simulate(TIMES), contents) < 1e-8  # type: ignore[operator]
