"""Languages as tables of words and templates, and a description in the words of one."""

import re
import textwrap
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from atoll.export.description import Description, Formula, Input, State
from atoll.export.naming import Naming, harmless, spelled
from atoll.export.template import Values, fill
from atoll.model.parameters import Parameter
from atoll_core.errors import UsageError
from atoll_core.expression.operators import SQRT
from atoll_core.expression.text.infix import Notation, to_code

_WIDTH: Final = 100
"""Columns of a heading."""
_TOLERANCE: Final = 1e-12
"""Relative error of a step."""
_LEAST_NOMINAL: Final = 1e-30
"""Of the initial value: tools divide by nominal values, whose squares are to be numbers."""
_UNDEFINED: Final = (
    "Arithmetic is that of doubles. Where the mathematics has no value (a division by zero, the logarithm or a broken "
    "power of a negative number)"
)
_NOISE: Final = "Noise: dx = f dt + g dW in the sense of Ito; g is the root of the covariance per time."
_LARGE_ANGLES: Final = "sin and cos of more than 1e5, which Atoll's search takes for undefined, have values here."


@dataclass(frozen=True, kw_only=True)
class Language:
    """The words of a language and the templates of its files, which docs/how-to/export-format.md describes.

    `name` is what sentences call it, `notation` how it writes expressions, `naming` what it takes as a name, `time`
    what it calls the time; `comment` begins a line of one, `remark` is the form of what is said behind a statement.
    `where_undefined` says what happens where an expression has no value. Templates: `motion` of a file of what moves in
    time, `regression` of a function ("" where there is none), `usage` of lines that say how the file is used. Without
    `has_noise` a process is refused, without `has_tables` an input along one. Lines have `longest` characters at most.
    """

    name: str
    notation: Notation
    naming: Naming
    time: str
    comment: str
    where_undefined: str
    motion: str = ""
    regression: str = ""
    usage: str = ""
    remark: str = ""
    has_noise: bool = False
    has_tables: bool = True
    longest: int | None = None

    @property
    def without_tables(self) -> str:
        """The name of a language without tables, "" of others."""
        return "" if self.has_tables else self.name

    def write(self, model: Description) -> str:
        """Return a file; raises UsageError where a line would be too long."""
        words = Wording(model, self)
        heading = [f"{self.comment} {line}".rstrip() for line in words.heading]
        template = self.motion if model.states else self.regression
        lines = [*heading, "", *fill(template, words.values)]
        for line in lines:
            if self.longest and len(line) > self.longest:
                name, fault = re.split("[='(]", line)[0], f"{len(line)} characters, {self.name} reads {self.longest}"
                raise UsageError(f"the equation of {name} has {fault}; use another format")
        return "\n".join(lines) + "\n"


class Wording:
    """A description in the words of a language."""

    def __init__(self, model: Description, language: Language) -> None:
        self.model = model
        self.language = language
        places = range(len(model.states) if model.covariance else 0)
        noise = [f"{kind}{i + 1}_{j + 1}" for kind in ("b", "g") for i in places for j in range(i + 1)]
        noise += [f"w{place + 1}" for place in places]
        # Keys with a blank are no names of variables.
        wanted = {variable.name: variable.name for variable in model.variables}
        wanted |= {f"constant {constant.name}": constant.name for constant in model.constants}
        wanted |= {f"noise {name}": name for name in noise}
        self._names = language.naming.assign(wanted)
        self._names |= {variable.name: language.time for variable in model.inputs if variable.kind == "time"}

    def __getitem__(self, named: State | Input | Parameter) -> str:
        """Return what a variable or a constant is called."""
        return self.constant(named.name) if isinstance(named, Parameter) else self._names[named.name]

    def constant(self, name: str) -> str:
        """Return what a constant is called, by its name in the model."""
        return self._names[f"constant {name}"]

    def expression(self, formula: Formula) -> str:
        """Return an expression."""
        symbols = [self._names.get(name, "") for name in self.model.symbols]
        constants = {place: self.constant(name) for place, name in formula.constants.items()}
        return to_code(formula.program, symbols, self.language.notation, constants)

    def note(self, constant: Parameter) -> str:
        """Return what is known of a constant: unit and standard error."""
        unit = harmless(constant.unit) if constant.unit is not None and constant.unit != "1" else ""
        error = "" if constant.stderr is None else f"standard error {constant.stderr:.2g}"
        return self._quoted(", ".join(part for part in (unit, error) if part))

    def about(self, variable: State | Input) -> str:
        """Return what a variable is: its column and unit."""
        unit = f" [{harmless(variable.unit)}]" if variable.unit else ""
        return self._quoted(f"column {harmless(variable.column)}{unit}")

    def _quoted(self, text: str) -> str:
        """Return a text as it may stand in a remark, which is a string in some languages."""
        return text.replace('"', "'") if '"' in self.language.remark else text

    @property
    def heading(self) -> list[str]:
        """What stands above: where the model comes from, what is called how, how the file is used."""
        model, language = self.model, self.language
        named = [(self[each], each.column, f"column '{each.column}'") for each in model.variables]
        named += [(self[each], each.name, f"constant {each.name}") for each in model.constants]
        renamed = [f"  {name} is the {text}" for name, wanted, text in named if name != wanted]
        lines = [
            *model.origin,
            *([""] if model.zeros else []),
            *model.zeros,
            *(["", "Names:", *renamed] if renamed else []),
            *(["", _NOISE] if model.covariance else []),
            "",
            *fill(language.usage, self.values),
            f"{_UNDEFINED} {language.where_undefined}. {_LARGE_ANGLES}",
        ]
        return [part for line in lines for part in _wrapped(line)]

    # ------------------------------------------------------------------------------------------- what templates name

    @cached_property
    def values(self) -> Values:
        """What templates can name."""
        model = self.model
        constants: list[Values] = []
        for constant in model.constants:
            note = self.note(constant)
            remark = self.language.remark.format(note) if note else ""
            constants.append({"name": self[constant], "value": constant.value, "remark": remark})
        held: list[Values] = [
            {"name": self[held], "value": held.value, "about": self.about(held)} for held in model.held
        ]
        parameters = [*constants, *held] if model.states else constants
        step = (model.end - model.begin) / model.steps
        return {
            "states": self._states,
            "comma_of_one": "," if len(model.states) == 1 else "",
            "constants": constants,
            "held": held,
            "parameters": [{**parameter, "place": place} for place, parameter in enumerate(parameters)],
            "tables": [self._table(variable) for variable in model.tables],
            "inputs": [{"name": self[variable]} for variable in model.inputs],
            "process": bool(model.covariance),
            "noise": [{"name": name, "expression": text} for name, text in self._noise[0]],
            "target": spelled(model.target),
            "formula": "" if model.value is None else self.expression(model.value),
            "header": ",".join([spelled(model.time), *(self[state] for state in model.states)]),
            "time": spelled(model.time),
            "first_time": model.begin,
            "last_time": model.end,
            "duration": model.end - model.begin,
            "steps": model.steps,
            "rows": model.steps + 1,
            "reserved_rows": max(5000, model.steps + 2),
            "step": step,
            "substep": step / 100,
            "least": _TOLERANCE * min((state.size for state in model.states), default=0.0),
        }

    @property
    def _states(self) -> list[Values]:
        size, rows = len(self.model.states), self._noise[1]
        normals = [self._names[f"noise w{place + 1}"] if rows else "" for place in range(size)]
        rows = rows or [[]] * size
        return [
            {
                "name": self[state],
                "about": self.about(state),
                "place": place,
                "number": place + 1,
                "rate": self.expression(state.rate),
                "start": state.start,
                "size": state.size,
                "least": _TOLERANCE * state.size,
                "nominal": max(state.size, _LEAST_NOMINAL * abs(state.start)),
                "normal": normals[place],
                "row": [{"root": root or "0.0"} for root in row],
                "terms": [{"root": root, "factor": factor} for root, factor in zip(row, normals, strict=False) if root],
            }
            for place, (state, row) in enumerate(zip(self.model.states, rows, strict=True))
        ]

    def _table(self, variable: Input) -> Values:
        assert variable.table is not None
        names: list[str] = ["since", "c0", "c1", "c2", "c3"]
        cubics = [dict(zip(names, row, strict=True)) for row in variable.table.tolist()]
        first = {"name": self[variable], "about": self.about(variable), "since": cubics[0]["since"]}
        return {**first, "until": variable.until, "cubics": cubics}

    @cached_property
    def _noise(self) -> tuple[list[tuple[str, str]], list[list[str]]]:
        """What multiplies dW: assignments (name, expression) in order, and the names in each row of g, "" for 0.

        g is the lower triangle with g g' = B (Cholesky).
        """
        root = self.language.notation.call(SQRT)
        size = len(self.model.states) if self.model.covariance else 0
        assignments = [
            (self._names[f"noise b{max(pair) + 1}_{min(pair) + 1}"], self.expression(formula))
            for pair, formula in self.model.covariance.items()
        ]
        rows = [[""] * size for _ in range(size)]
        for i in range(size):
            for j in range(i + 1):
                products = [f"{rows[i][k]}*{rows[j][k]}" for k in range(j) if rows[i][k] and rows[j][k]]
                has_own = (min(i, j), max(i, j)) in self.model.covariance
                if not has_own and (not products or i == j):
                    continue
                difference = " - ".join([self._names[f"noise b{i + 1}_{j + 1}"] if has_own else "0.0", *products])
                rows[i][j] = self._names[f"noise g{i + 1}_{j + 1}"]
                text = f"{root}({difference})" if i == j else f"({difference})/{rows[j][j]}"
                assignments.append((rows[i][j], text))
        return assignments, rows


def _wrapped(line: str) -> list[str]:
    indent = line[: len(line) - len(line.lstrip())]
    further = f"{indent}  " if indent else ""
    return textwrap.wrap(harmless(line), _WIDTH, initial_indent=indent, subsequent_indent=further) or [""]
