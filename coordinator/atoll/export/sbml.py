"""SBML Level 3 Version 2: states and constants as parameters, rate rules, initial values, units.

The document is written as text, because libsbml writes only 15 digits of a number, which can change a double. If
libsbml is installed (the extra ``sbml``), it checks every document.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final
from xml.sax.saxutils import escape, quoteattr

from atoll.export.description import Description, ExportedInput, ExportedState, Formula
from atoll.export.language import Language, Naming, Values, Wording, fill, harmless
from atoll_coordinator.units import expanded, is_factor, parse_unit
from atoll_core.errors import UsageError
from atoll_core.expression.operators import OPERATORS
from atoll_core.expression.text.infix import INFIX

_WORDS: Final = (
    "time avogadro delay rateOf pi exponentiale infinity notanumber inf nan true false and or not xor if "
    "piecewise lambda model end at in is has var species compartment function event sin cos tan exp ln log log10 "
    "sqrt abs tanh pow power root floor ceil factorial begin_time substance volume area length extent atoll_model"
)
_ELEMENTS: Final = {"+": "plus", "-": "minus", "*": "times", "/": "divide", "pow": "power", "log": "ln", "sqrt": "root"}
"""Operators with other names in MathML."""
_KINDS: Final = {"m": "metre", "s": "second", "g": "gram", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela"}
"""Names of SI base units in SBML."""
_TIME: Final = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time"> time </csymbol>'


class _Sbml(Language):
    def write(self, model: Description, *, has_start_parameters: bool = False) -> str:
        """Return a document.

        With `has_start_parameters`, the initial state is given by constants ``start_`` and the name of the state; PEtab
        sets these constants. The time in the equations is then the simulation time plus the constant ``begin_time``.

        Raises:
            UsageError: libsbml finds an error.
        """
        words, units = Wording(model, self), UnitDefinitions()
        starts = [{"id": words[state], "math": _math(_name(start_name(words, state)))} for state in model.states]
        values: Values = {
            "time_unit": _attributes(timeUnits=units.of(model.time_unit)),
            "heading": _lines(words.heading),
            "parameters": [*_parameters(words, units, has_start_parameters)],
            "starts": starts if has_start_parameters else [],
            "rules": [*_rules(words, has_start_parameters)],
            "units": units.definitions(),
        }
        text = "\n".join(fill(self.motion, values)) + "\n"
        check(text)
        return text


SBML: Final = _Sbml(
    name="SBML",
    notation=INFIX,
    naming=Naming(frozenset(_WORDS.split()), ("start_", "sd_", "observable_")),
    time="time",
    comment="",
    where_undefined="the tool ends the simulation",
    motion="""\
<?xml version="1.0" encoding="UTF-8"?>
<sbml xmlns="http://www.sbml.org/sbml/level3/version2/core" level="3" version="2">
  <model id="atoll_model" name="model found by Atoll"$time_unit>
    <notes><body xmlns="http://www.w3.org/1999/xhtml">
$for heading:      <p>$line</p>
    </body></notes>
$if units:
    <listOfUnitDefinitions>
$for units:
      <unitDefinition id="$name"><listOfUnits>
$for factors:        <unit kind="$kind" exponent="$exponent" scale="0" multiplier="$multiplier"/>
      </listOfUnits></unitDefinition>
$end
    </listOfUnitDefinitions>
$end
    <listOfParameters>
$for parameters:
$unless notes:      <parameter id="$id"$attributes/>
$if notes:
      <parameter id="$id"$attributes>
        <notes><body xmlns="http://www.w3.org/1999/xhtml">
$for notes:          <p>$line</p>
        </body></notes>
      </parameter>
$end
$end
    </listOfParameters>
$if starts:
    <listOfInitialAssignments>
$for starts:      <initialAssignment symbol="$id">$math</initialAssignment>
    </listOfInitialAssignments>
$end
    <listOfRules>
$for rules:
      <$kind variable="$id">
        $math
      </$kind>
$end
    </listOfRules>
  </model>
</sbml>
""",
)


Factor = tuple[str, float, float]
"""A unit of SBML: its kind, its exponent, its multiplier."""


class UnitDefinitions:
    """The unit definitions of a document."""

    def __init__(self) -> None:
        self._known: dict[tuple[Factor, ...], str] = {}

    def of(self, text: str | None) -> str:
        """Return the name of the definition of a unit; "" if SBML cannot express the unit."""
        factors = factors_of(text or "")
        return self._known.setdefault(factors, f"unit_{len(self._known) + 1}") if factors else ""

    def definitions(self) -> list[Values]:
        """Return the definitions of all requested units, for the template of a document."""
        return [
            {
                "name": name,
                "factors": [
                    {"kind": kind, "exponent": f"{exponent:g}", "multiplier": size} for kind, exponent, size in factors
                ],
            }
            for factors, name in self._known.items()
        ]


def factors_of(text: str) -> tuple[Factor, ...]:
    """Return the factors of a unit; empty if the unit is not an SI unit or a factor overflows."""
    if not text.strip():
        return ()
    try:
        powers = expanded(parse_unit(text))
    except UsageError:
        return ()
    if any(not is_factor(symbol) and symbol not in _KINDS for symbol in powers):
        return ()
    kinds = [(_KINDS[symbol], float(power)) for symbol, power in powers.items() if symbol in _KINDS]
    kind, exponent = kinds[0] if kinds else ("dimensionless", 1.0)
    try:
        size = math.prod(float(symbol) ** float(power) for symbol, power in powers.items() if is_factor(symbol))
        multiplier = float(
            f"{size ** (1.0 / exponent):.15g}"
        )  # (multiplier kind)^exponent: the first kind gets the size of all
    except (OverflowError, ZeroDivisionError):
        return ()
    if not 0.0 < multiplier < math.inf:
        return ()
    first = (kind, exponent, multiplier)
    return (first, *((kind, exponent, 1.0) for kind, exponent in kinds[1:]))


def start_name(words: Wording, state: ExportedState) -> str:
    """Return the name of the constant for the initial value of a state."""
    return f"start_{words[state]}"


def check(text: str) -> None:
    """Check a document with libsbml, if it is installed; raises UsageError with its first error."""
    try:
        import libsbml
    except ImportError:
        return
    document = libsbml.readSBMLFromString(text)
    document.checkConsistency()
    for number in range(document.getNumErrors()):
        error = document.getError(number)
        if error.getSeverity() >= libsbml.LIBSBML_SEV_ERROR:
            raise UsageError(
                f"libsbml finds an error in the SBML of this model ({harmless(error.getMessage())}); use another format"
            )


def _parameters(words: Wording, units: UnitDefinitions, has_start_parameters: bool) -> Iterator[Values]:
    model = words.model
    for state in model.states:
        unit, start = units.of(state.unit), repr(state.start)
        value = "" if has_start_parameters else start
        yield _parameter(words[state], state.column, value, unit, words.about(state), constant="false")
        if has_start_parameters:
            yield _parameter(start_name(words, state), f"initial {state.column}", start, unit)
    if has_start_parameters and model.depends_on_time:
        yield _parameter("begin_time", "time at which the simulation begins", "0.0", units.of(model.time_unit))
    for each in model.constants:
        notes = [words.note(each)] if each.stderr is not None else []
        if each.interval is not None:
            notes.append(f"95 % interval {each.interval[0]!r} to {each.interval[1]!r}")
        yield _parameter(words[each], f"constant {each.name}", repr(each.value), units.of(each.unit), *notes)
    for variable in (*model.held, *model.tables):
        value, constant = (repr(variable.value), "true") if variable.kind == "value" else ("", "false")
        note, unit = f"input, {words.about(variable)}", units.of(variable.unit)
        yield _parameter(words[variable], variable.column, value, unit, note, constant=constant)
    for one in model.observed:
        note = f"computed from states, {words.about(one)}"
        yield _parameter(words[one], one.column, "", units.of(one.unit), note, constant="false")


def _parameter(name: str, title: str, value: str, unit: str, *notes: str, constant: str = "true") -> Values:
    attributes = _attributes(name=harmless(title), value=value, units=unit, constant=constant)
    return {"id": name, "attributes": attributes, "notes": _lines(notes)}


def _rules(words: Wording, has_start_parameters: bool) -> Iterator[Values]:
    model = words.model
    for table in model.tables:
        yield {"kind": "assignmentRule", "id": words[table], "math": _math(_piecewise(table))}
    time = _apply("plus", _TIME, _name("begin_time")) if has_start_parameters else _TIME
    elements = {variable.name: _name(words[variable]) for variable in model.variables}
    symbols = [elements.get(name, time) for name in model.symbols]
    for state in model.states:
        yield {"kind": "rateRule", "id": words[state], "math": _math(_expression(state.rate, symbols, words))}
    for one in model.observed:
        yield {"kind": "assignmentRule", "id": words[one], "math": _math(_expression(one.value, symbols, words))}


def _math(content: str) -> str:
    return f'<math xmlns="http://www.w3.org/1998/Math/MathML">{content}</math>'


def _apply(function: str, *operands: str) -> str:
    return f"<apply><{function}/>{''.join(operands)}</apply>"


def _name(name: str) -> str:
    return f"<ci> {name} </ci>"


def _number(value: float) -> str:
    mantissa, exponent, power = repr(value).partition("e")
    if exponent:
        return f'<cn type="e-notation"> {mantissa} <sep/> {int(power)} </cn>'
    return f"<cn> {mantissa} </cn>"


def _expression(formula: Formula, symbols: Sequence[str], words: Wording) -> str:
    nodes: list[str] = []
    for place, (code, left, right, value) in enumerate(formula.program.nodes()):
        match OPERATORS[code].name:
            case "variable":
                nodes.append(symbols[left])
            case "constant":
                name = formula.constants.get(place)
                nodes.append(_number(value) if name is None else _name(words.constant(name)))
            case "inverse":
                nodes.append(_apply("divide", _number(1.0), nodes[left]))
            case "square":
                nodes.append(_apply("power", nodes[left], _number(2.0)))
            case "neg":
                nodes.append(_apply("minus", nodes[left]))
            case operator:
                operands = (left, right)[: OPERATORS[code].arity]
                nodes.append(_apply(_ELEMENTS.get(operator, operator), *(nodes[operand] for operand in operands)))
    return nodes[-1]


def _piecewise(variable: ExportedInput) -> str:
    """Return an input as piecewise cubics of the time; it is constant before the first and after the last piece."""
    assert variable.table is not None
    rows = variable.table.tolist()
    ends = [*(row[0] for row in rows[1:]), variable.until]
    parts = [f"<piece>{_number(rows[0][1])}{_apply('lt', _TIME, _number(rows[0][0]))}</piece>"]
    for row, end in zip(rows, ends, strict=True):
        inside = _apply("and", _apply("geq", _TIME, _number(row[0])), _apply("lt", _TIME, _number(end)))
        parts.append(f"<piece>{_cubic(row, _apply('minus', _TIME, _number(row[0])))}{inside}</piece>")
    s = variable.until - rows[-1][0]
    last = rows[-1][1] + s * (rows[-1][2] + s * (rows[-1][3] + s * rows[-1][4]))
    return f"<piecewise>{''.join(parts)}<otherwise>{_number(last)}</otherwise></piecewise>"


def _cubic(row: Sequence[float], s: str) -> str:
    text = _number(row[4])
    for coefficient in reversed(row[1:4]):
        text = _apply("plus", _number(coefficient), _apply("times", s, text))
    return text


def _lines(texts: Sequence[str]) -> list[Values]:
    return [{"line": escape(harmless(text))} for text in texts if text.strip()]


def _attributes(**values: str) -> str:
    return "".join(f" {name}={quoteattr(value)}" for name, value in values.items() if value)
