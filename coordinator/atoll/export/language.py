"""Languages as tables of words and templates, and a `Description` in the words of a language. All functions are pure.

Each language allows only some names. Therefore names of columns are written in ASCII, and changed if a language
reserves them.

Templates: `$name` is replaced by a value, or by the number of items of a list. `<<items|text|separator>>` repeats the
text for each item; the default separator is ", ". Lines can be repeated or conditional. ``$for items:line`` repeats the
line for each item. ``$for items,:line`` also puts a comma (or a semicolon) between the lines. ``$if name:line`` keeps
the line if the value is neither 0 nor empty, and ``$unless name:line`` keeps it otherwise. If the line after the colon
is empty, the instruction applies to all lines up to its ``$end``. Values of an item hide outer values with the same
name.
"""

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from atoll.export.description import Description, ExportedColumn, ExportedInput, ExportedState, Formula
from atoll.model.equations import Parameter
from atoll_core.errors import UsageError
from atoll_core.expression.operators import SQRT
from atoll_core.expression.text.infix import Notation, to_code

Value = str | float | Sequence[Mapping[str, "Value"]]
Values = Mapping[str, Value]

_LINE: Final = re.compile(r"\$(for|if|unless) (\w+)([,;]?):(.*)")
_PART: Final = re.compile(r"<<(\w+)\|(.*?)(?:\|(.*?))?>>|\$(\w+)")


def fill(template: str, values: Values) -> list[str]:
    """Return the lines of a template, filled with `values`; raises KeyError for a missing value."""
    return list(_fill_lines(template.splitlines(), values))


def _fill_lines(template: Iterable[str], values: Values) -> Iterator[str]:
    lines = iter(template)
    for line in lines:
        instruction = _LINE.fullmatch(line)
        if instruction is None:
            yield _fill_line(line, values)
            continue
        word, name, separator, rest = instruction.groups()
        body = [rest] if rest else [*_block(lines)]
        if word == "for":
            scopes = _scopes(name, values)
            for number, scope in enumerate(scopes, start=1):
                *before, last = _fill_lines(body, scope)
                yield from before
                yield last + (separator if number < len(scopes) else "")
        elif bool(values[name]) is (word == "if"):
            yield from _fill_lines(body, values)


def _block(lines: Iterator[str]) -> Iterator[str]:
    depth = 1
    for line in lines:
        instruction = _LINE.fullmatch(line)
        depth += -1 if line == "$end" else instruction is not None and not instruction[4]
        if not depth:
            return
        yield line


def _scopes(name: str, values: Values) -> list[Values]:
    """Return the values visible inside each item of a list."""
    items = values[name]
    assert not isinstance(items, str | float | int), f"{name} is no list"
    return [{**values, **item} for item in items]


def _fill_line(line: str, values: Values) -> str:
    def replacement(part: re.Match[str]) -> str:
        items, text, separator, name = part.groups()
        if name:
            value = values[name]
            return str(value if isinstance(value, str | float | int) else len(value))
        return (", " if separator is None else separator).join(
            _fill_line(text, scope) for scope in _scopes(items, values)
        )

    return _PART.sub(replacement, line)


_LETTER: Final = re.compile(r"(?:GREEK|CYRILLIC) (SMALL|CAPITAL) LETTER (?:FINAL )?(\w+)")


@dataclass(frozen=True)
class Naming:
    """The names that a language allows: ASCII letters, digits and _, beginning with a letter.

    A name has at most `longest` characters. `reserved` words are excluded, and names that begin with one of the
    `prefixes`. If the language `is_caseless`, names that differ only in case are equal.
    """

    reserved: frozenset[str]
    prefixes: tuple[str, ...] = ()
    longest: int = 60
    is_caseless: bool = False

    def assign(self, wanted: Mapping[str, str]) -> dict[str, str]:
        """Return a different name for each key: the `wanted` name if possible, otherwise a similar name.

        If several keys want the same name, the first key gets it.
        """
        names: dict[str, str] = {}
        taken: set[str] = set()
        for key in sorted(wanted, key=lambda wish: not self._is_good(wanted[wish])):
            name = wanted[key]
            names[key] = self._unique(name if self._is_good(name) else self._rewrite(name), taken)
            taken.add(self._key(names[key]))
        return {key: names[key] for key in wanted}

    def _key(self, name: str) -> str:
        return name.lower() if self.is_caseless else name

    def _is_good(self, name: str) -> bool:
        is_plain = re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) is not None and len(name) <= self.longest
        return is_plain and not self._is_reserved(name) and not name.startswith(self.prefixes)

    def _is_reserved(self, name: str) -> bool:
        return self._key(name) in {self._key(word) for word in self.reserved}

    def _rewrite(self, name: str) -> str:
        text = re.sub(r"_+", "_", spell(name)).strip("_")
        if not text[:1].isalpha() or text.startswith(self.prefixes):
            text = "x" + text
        text = text[: self.longest]
        return text[: self.longest - 1] + "_" if self._is_reserved(text) else text

    def _unique(self, name: str, taken: set[str]) -> str:
        number, chosen = 2, name
        while self._key(chosen) in taken or self._is_reserved(chosen):
            ending = f"_{number}"
            chosen = name[: self.longest - len(ending)] + ending
            number += 1
        return chosen


def spell(name: str) -> str:
    """Return `name` in ASCII letters, digits and _: accents are removed, Greek and Cyrillic letters are named."""
    return "".join(map(_spell, unicodedata.normalize("NFKC", name)))


def _spell(character: str) -> str:
    plain = unicodedata.normalize("NFKD", character)[0]
    if plain.isascii():
        return plain if plain.isalnum() else "_"
    if letter := _LETTER.match(unicodedata.name(plain, "")):
        return letter[2].lower() if letter[1] == "SMALL" else letter[2].capitalize()
    return "_"


def harmless(text: str) -> str:
    """Return `text` as a comment in any language: one line, without backslashes and invisible characters."""
    kept = (
        character if unicodedata.category(character)[0] not in "CZ" else " "
        for character in text.replace("\\", "/").replace("*/", "* /")
    )
    return " ".join("".join(kept).split())


_WIDTH: Final = 100
"""Width of a heading in characters."""
_TOLERANCE: Final = 1e-12
"""Relative error of a step."""
_LEAST_NOMINAL: Final = 1e-30
"""Smallest nominal value, as a share of the initial value. Tools divide by nominal values, so their squares must not
underflow."""
_UNDEFINED: Final = (
    "All numbers are doubles. Where an expression is undefined (a division by zero, the logarithm or a fractional "
    "power of a negative number)"
)
_NOISE: Final = "Noise: dx = f dt + g dW (Ito); g is the Cholesky factor of the covariance per unit of time."
_LARGE_ANGLES: Final = "sin and cos of more than 1e5 have values here; in Atoll's search they are undefined."


@dataclass(frozen=True, kw_only=True)
class Language:
    """The words of a language and the templates of its files, which docs/how-to/export-format.md describes.

    `name` is its name in sentences, `notation` its notation of expressions, `naming` its allowed names, and `time` its
    name for the time. `comment` begins a comment line; `remark` is the template of a remark after a statement.
    `where_undefined` says what happens if an expression is undefined. There are three templates: `motion` for a model
    of dynamics, `regression` for a function ("" if the language has none), and `usage` for lines about the use of the
    file. Without `has_noise`, stochastic processes are refused; without `has_tables`, inputs with a table are refused.
    Lines have at most `longest` characters.
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
        """The name of the language if it has no tables, otherwise ""."""
        return "" if self.has_tables else self.name

    def write(self, model: Description) -> str:
        """Return the file; raises UsageError if a line is too long."""
        words = Wording(model, self)
        heading = [f"{self.comment} {line}".rstrip() for line in words.heading]
        template = self.motion if model.states else self.regression
        lines = [*heading, "", *fill(template, words.values)]
        for line in lines:
            if self.longest and len(line) > self.longest:
                name = re.split("[='(]", line)[0]
                fault = f"{len(line)} characters, but {self.name} reads at most {self.longest}"
                raise UsageError(f"the equation of {name} has {fault}; use another format")
        return "\n".join(lines) + "\n"


class Wording:
    """A description in the words of a language: names, expressions, and the values for its templates."""

    def __init__(self, model: Description, language: Language) -> None:
        self.model = model
        self.language = language
        places = range(len(model.states) if model.covariance else 0)
        noise = [f"{kind}{i + 1}_{j + 1}" for kind in ("b", "g") for i in places for j in range(i + 1)]
        noise += [f"w{place + 1}" for place in places]
        # a key with a space cannot be the name of a variable
        wanted = {variable.name: variable.name for variable in model.variables}
        wanted |= {f"constant {constant.name}": constant.name for constant in model.constants}
        wanted |= {f"noise {name}": name for name in noise}
        wanted |= {one.name: one.column for one in model.observed}
        self._names = language.naming.assign(wanted)
        self._names |= {variable.name: language.time for variable in model.inputs if variable.kind == "time"}

    def __getitem__(self, named: ExportedState | ExportedInput | ExportedColumn | Parameter) -> str:
        """Return the name of a variable or a constant."""
        return self.constant(named.name) if isinstance(named, Parameter) else self._names[named.name]

    def constant(self, name: str) -> str:
        """Return the name of a constant in the language, from its name in the model."""
        return self._names[f"constant {name}"]

    def expression(self, formula: Formula) -> str:
        """Return an expression in the notation of the language."""
        symbols = [self._names.get(name, "") for name in self.model.symbols]
        constants = {place: self.constant(name) for place, name in formula.constants.items()}
        return to_code(formula.program, symbols, self.language.notation, constants)

    def note(self, constant: Parameter) -> str:
        """Return unit and standard error of a constant."""
        unit = harmless(constant.unit) if constant.unit is not None and constant.unit != "1" else ""
        error = "" if constant.stderr is None else f"standard error {constant.stderr:.2g}"
        return self._quote(", ".join(part for part in (unit, error) if part))

    def about(self, variable: ExportedState | ExportedInput | ExportedColumn) -> str:
        """Return column and unit of a variable."""
        unit = f" [{harmless(variable.unit)}]" if variable.unit else ""
        return self._quote(f"column {harmless(variable.column)}{unit}")

    def _quote(self, text: str) -> str:
        """Return a text for a remark; in some languages a remark is a string, so " becomes '."""
        return text.replace('"', "'") if '"' in self.language.remark else text

    @property
    def heading(self) -> list[str]:
        """The heading of the file: origin of the model, changed names, usage."""
        model, language = self.model, self.language
        named = [(self[each], each.column, f"column '{each.column}'") for each in model.variables]
        named += [(self[each], each.name, f"constant {each.name}") for each in model.constants]
        named += [(self[each], each.column, f"column '{each.column}'") for each in model.observed]
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
        return [part for line in lines for part in _wrap(line)]

    @cached_property
    def values(self) -> Values:
        """The values that templates can use."""
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
            "observed": [
                {"name": self[one], "about": self.about(one), "place": place, "value": self.expression(one.value)}
                for place, one in enumerate(model.observed)
            ],
            "constants": constants,
            "held": held,
            "parameters": [{**parameter, "place": place} for place, parameter in enumerate(parameters)],
            "tables": [self._table(variable) for variable in model.tables],
            "inputs": [{"name": self[variable]} for variable in model.inputs],
            "process": bool(model.covariance),
            "noise": [{"name": name, "expression": text} for name, text in self._noise[0]],
            "target": spell(model.target),
            "formula": "" if model.value is None else self.expression(model.value),
            "header": ",".join([spell(model.time), *(self[state] for state in model.states)]),
            "time": spell(model.time),
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

    def _table(self, variable: ExportedInput) -> Values:
        assert variable.table is not None
        names: list[str] = ["since", "c0", "c1", "c2", "c3"]
        cubics = [dict(zip(names, row, strict=True)) for row in variable.table.tolist()]
        first = {"name": self[variable], "about": self.about(variable), "since": cubics[0]["since"]}
        return {**first, "until": variable.until, "cubics": cubics}

    @cached_property
    def _noise(self) -> tuple[list[tuple[str, str]], list[list[str]]]:
        """The factor g of dW: assignments (name, expression) in order, and the names in each row of g, "" for 0.

        g is the lower triangular matrix with g gᵀ = B (Cholesky), the covariance per unit of time.
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


def _wrap(line: str) -> list[str]:
    indent = line[: len(line) - len(line.lstrip())]
    further = f"{indent}  " if indent else ""
    return textwrap.wrap(harmless(line), _WIDTH, initial_indent=indent, subsequent_indent=further) or [""]
