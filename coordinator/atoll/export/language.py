"""Languages as tables of words and templates, and a description in the words of one. Pure.

A language takes some names only: names of columns are spelled in ASCII and changed where a language reserves them.

Templates: `$name` is a value, or the number of items of a list. `<<items|text|separator>>` is the text for each item,
the separator ", " by default. Whole lines can be conditional: ``$for items:line`` repeats a line for each item, with a
comma in between as ``$for items,:line`` (or a semicolon); ``$if name:line`` keeps it where a value is neither 0 nor
empty, ``$unless name:line`` where it is. With nothing after the colon they hold for all lines down to their ``$end``.
Within an item its values hide outer ones.
"""

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from atoll.export.description import Description, ExportedInput, ExportedState, Formula
from atoll.model.equations import Parameter
from atoll_core.errors import UsageError
from atoll_core.expression.operators import SQRT
from atoll_core.expression.text.infix import Notation, to_code

Value = str | float | Sequence[Mapping[str, "Value"]]
Values = Mapping[str, Value]

_LINE: Final = re.compile(r"\$(for|if|unless) (\w+)([,;]?):(.*)")
_PART: Final = re.compile(r"<<(\w+)\|(.*?)(?:\|(.*?))?>>|\$(\w+)")


def fill(template: str, values: Values) -> list[str]:
    """Return the lines of a template with values; raises KeyError where one is missing."""
    return list(_filled(template.splitlines(), values))


def _filled(template: Iterable[str], values: Values) -> Iterator[str]:
    lines = iter(template)
    for line in lines:
        instruction = _LINE.fullmatch(line)
        if instruction is None:
            yield _text(line, values)
            continue
        word, name, separator, rest = instruction.groups()
        body = [rest] if rest else [*_block(lines)]
        if word == "for":
            scopes = _scopes(name, values)
            for number, scope in enumerate(scopes, start=1):
                *before, last = _filled(body, scope)
                yield from before
                yield last + (separator if number < len(scopes) else "")
        elif bool(values[name]) is (word == "if"):
            yield from _filled(body, values)


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


def _text(line: str, values: Values) -> str:
    def written(part: re.Match[str]) -> str:
        items, text, separator, name = part.groups()
        if name:
            value = values[name]
            return str(value if isinstance(value, str | float | int) else len(value))
        return (", " if separator is None else separator).join(_text(text, scope) for scope in _scopes(items, values))

    return _PART.sub(written, line)


_LETTER: Final = re.compile(r"(?:GREEK|CYRILLIC) (SMALL|CAPITAL) LETTER (?:FINAL )?(\w+)")


@dataclass(frozen=True)
class Naming:
    """The names that a language allows: ASCII letters, digits and _, a letter first, at most `longest` characters.

    `reserved` words are excluded, and names that begin with one of `prefixes`; where the language `is_caseless`, names
    that differ in case alone are equal.
    """

    reserved: frozenset[str]
    prefixes: tuple[str, ...] = ()
    longest: int = 60
    is_caseless: bool = False

    def assign(self, wanted: Mapping[str, str]) -> dict[str, str]:
        """Return a name for each key: the wanted one if possible, otherwise a similar one; all are different.

        If several keys want the same name, the first gets it.
        """
        names: dict[str, str] = {}
        taken: set[str] = set()
        for key in sorted(wanted, key=lambda wish: not self._is_good(wanted[wish])):
            name = wanted[key]
            names[key] = self._unique(name if self._is_good(name) else self._rewritten(name), taken)
            taken.add(self._key(names[key]))
        return {key: names[key] for key in wanted}

    def _key(self, name: str) -> str:
        return name.lower() if self.is_caseless else name

    def _is_good(self, name: str) -> bool:
        is_plain = re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) is not None and len(name) <= self.longest
        return is_plain and not self._is_reserved(name) and not name.startswith(self.prefixes)

    def _is_reserved(self, name: str) -> bool:
        return self._key(name) in {self._key(word) for word in self.reserved}

    def _rewritten(self, name: str) -> str:
        text = re.sub(r"_+", "_", spelled(name)).strip("_")
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


def spelled(name: str) -> str:
    """Return `name` in ASCII letters, digits and _: without accents, Greek and Cyrillic letters by their names."""
    return "".join(map(_spelled, unicodedata.normalize("NFKC", name)))


def _spelled(character: str) -> str:
    plain = unicodedata.normalize("NFKD", character)[0]
    if plain.isascii():
        return plain if plain.isalnum() else "_"
    if letter := _LETTER.match(unicodedata.name(plain, "")):
        return letter[2].lower() if letter[1] == "SMALL" else letter[2].capitalize()
    return "_"


def harmless(text: str) -> str:
    """Return `text` for a comment in any language: one line, no backslash, no invisible character."""
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
"""Share of the initial value: tools divide by nominal values, whose squares must not underflow."""
_UNDEFINED: Final = (
    "Arithmetic is that of doubles. Where the mathematics has no value (a division by zero, the logarithm or a "
    "fractional power of a negative number)"
)
_NOISE: Final = "Noise: dx = f dt + g dW in the sense of Ito; g is the root of the covariance per time."
_LARGE_ANGLES: Final = "sin and cos of more than 1e5, which Atoll's search takes for undefined, have values here."


@dataclass(frozen=True, kw_only=True)
class Language:
    """The words of a language and the templates of its files, which docs/how-to/export-format.md describes.

    `name` is its name in sentences, `notation` its notation of expressions, `naming` its allowed names, `time` its name
    of the time; `comment` begins a comment line, `remark` is the form of a remark after a statement. `where_undefined`
    says what happens where an expression is undefined. Templates: `motion` for a model of dynamics, `regression` for a
    function ("" without), `usage` for lines on how to use the file. Without `has_noise` a process is refused, without
    `has_tables` an input that follows a table. Lines have `longest` characters at most.
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
        """The name of a language without tables, "" for others."""
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
        # Keys with a blank are not names of variables.
        wanted = {variable.name: variable.name for variable in model.variables}
        wanted |= {f"constant {constant.name}": constant.name for constant in model.constants}
        wanted |= {f"noise {name}": name for name in noise}
        self._names = language.naming.assign(wanted)
        self._names |= {variable.name: language.time for variable in model.inputs if variable.kind == "time"}

    def __getitem__(self, named: ExportedState | ExportedInput | Parameter) -> str:
        """Return the name of a variable or a constant."""
        return self.constant(named.name) if isinstance(named, Parameter) else self._names[named.name]

    def constant(self, name: str) -> str:
        """Return the name of a constant, by its name in the model."""
        return self._names[f"constant {name}"]

    def expression(self, formula: Formula) -> str:
        """Return an expression."""
        symbols = [self._names.get(name, "") for name in self.model.symbols]
        constants = {place: self.constant(name) for place, name in formula.constants.items()}
        return to_code(formula.program, symbols, self.language.notation, constants)

    def note(self, constant: Parameter) -> str:
        """Return unit and standard error of a constant."""
        unit = harmless(constant.unit) if constant.unit is not None and constant.unit != "1" else ""
        error = "" if constant.stderr is None else f"standard error {constant.stderr:.2g}"
        return self._quoted(", ".join(part for part in (unit, error) if part))

    def about(self, variable: ExportedState | ExportedInput) -> str:
        """Return column and unit of a variable."""
        unit = f" [{harmless(variable.unit)}]" if variable.unit else ""
        return self._quoted(f"column {harmless(variable.column)}{unit}")

    def _quoted(self, text: str) -> str:
        """Return a text for a remark, which is a string in some languages."""
        return text.replace('"', "'") if '"' in self.language.remark else text

    @property
    def heading(self) -> list[str]:
        """The heading of the file: origin of the model, changed names, usage."""
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

    @cached_property
    def values(self) -> Values:
        """The values that templates can name."""
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

    def _table(self, variable: ExportedInput) -> Values:
        assert variable.table is not None
        names: list[str] = ["since", "c0", "c1", "c2", "c3"]
        cubics = [dict(zip(names, row, strict=True)) for row in variable.table.tolist()]
        first = {"name": self[variable], "about": self.about(variable), "since": cubics[0]["since"]}
        return {**first, "until": variable.until, "cubics": cubics}

    @cached_property
    def _noise(self) -> tuple[list[tuple[str, str]], list[list[str]]]:
        """The factor g of dW: assignments (name, expression) in order, and the names in each row of g, "" for 0.

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
