"""SBML Level 3 Version 2: states and constants as parameters, rate rules, initial values, units; for biology.

Written as text here: libsbml writes 15 digits of a number, which gives other doubles. Where it is installed (the extra
``sbml``), it checks what was written.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import escape, quoteattr

from atoll.export.content import Content, Formula, Input, Language, Wording, refuse_noise, refuse_regression
from atoll.export.naming import Naming, harmless
from atoll.export.sbml_units import Units
from atoll_core.errors import UsageError
from atoll_core.expression.operators import (
    ADD,
    ARITY,
    CONSTANT,
    DIVIDE,
    FUNCTIONS,
    INVERSE,
    LOG,
    MULTIPLY,
    NEGATE,
    POW,
    SQRT,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll_core.expression.text.notation import INFIX

_WORDS: Final = (
    "time avogadro delay rateOf pi exponentiale infinity notanumber inf nan true false and or not xor if "
    "piecewise lambda model end at in is has var species compartment function event sin cos tan exp ln log log10 "
    "sqrt abs tanh pow power root floor ceil factorial begin_time substance volume area length extent atoll_model"
)
LANGUAGE: Final = Language(
    INFIX,
    Naming(frozenset(_WORDS.split()), ("start_", "sd_", "observable_")),
    "time",
    "",
    "the tool ends the simulation",
)

_NAMES: Final = {
    **FUNCTIONS,
    **{ADD: "plus", SUBTRACT: "minus", MULTIPLY: "times", DIVIDE: "divide", POW: "power", LOG: "ln", SQRT: "root"},
}
"""Operators in MathML."""
_TIME: Final = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time"> time </csymbol>'
_MATH: Final = '<math xmlns="http://www.w3.org/1998/Math/MathML">'


@dataclass(frozen=True)
class Options:
    """How the file is to be used.

    With `has_start_parameters` the initial state is that of constants named after the states, which others can set, and
    the time of the equations is that of the simulation plus the constant ``begin_time``.
    """

    has_start_parameters: bool = False


def write(content: Content, options: Options = Options()) -> str:
    """Return a document.

    Raises:
        UsageError: of a process and of a regression; libsbml finds an error.
    """
    refuse_noise(content, "SBML")
    refuse_regression(content, "SBML")
    text = "\n".join(_document(content, options)) + "\n"
    check(text)
    return text


def start_name(words: Wording, state: str) -> str:
    """Return the name of the constant that a state begins with."""
    return f"start_{words[state]}"


def check(text: str) -> None:
    """Check a document by libsbml, where it is installed; raises UsageError with its first error."""
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
                f"libsbml refuses the SBML of this model ({harmless(error.getMessage())}); use another format"
            )


def _document(content: Content, options: Options) -> Iterable[str]:
    words = Wording(content, LANGUAGE)
    units = Units()
    time = _TIME
    if options.has_start_parameters and any(each.kind == "time" for each in content.inputs):
        time = f"<apply><plus/>{_TIME}<ci> begin_time </ci></apply>"
    time_unit = units.of(content.time_unit)
    body = [*_parameters(content, words, units, options), *_starts(content, words, options)]
    body += _rules(content, words, time)
    yield '<?xml version="1.0" encoding="UTF-8"?>'
    yield '<sbml xmlns="http://www.sbml.org/sbml/level3/version2/core" level="3" version="2">'
    yield f'  <model id="atoll_model" name="model found by Atoll"{_attribute("timeUnits", time_unit)}>'
    yield from _notes(words.heading(), "    ")
    yield from units.definitions()
    yield from body
    yield "  </model>"
    yield "</sbml>"


def _parameters(content: Content, words: Wording, units: "Units", options: Options) -> Iterable[str]:
    yield "    <listOfParameters>"
    for state, begin in zip(content.states, content.start, strict=True):
        unit = units.of(state.unit)
        value = "" if options.has_start_parameters else repr(begin)
        yield from _parameter(words[state.name], state.column, value, unit, [words.about(state)], is_constant=False)
        if options.has_start_parameters:
            name = start_name(words, state.name)
            yield from _parameter(name, f"{state.column} at the beginning", repr(begin), unit, [])
    if options.has_start_parameters and any(each.kind == "time" for each in content.inputs):
        yield from _parameter(
            "begin_time", "time at which the simulation begins", "0.0", units.of(content.time_unit), []
        )
    for constant in content.constants:
        notes = [words.note(constant)] if constant.stderr is not None else []
        if constant.interval is not None:
            notes.append(f"95 % interval {constant.interval[0]!r} to {constant.interval[1]!r}")
        yield from _parameter(
            words[constant], f"constant {constant.name}", repr(constant.value), units.of(constant.unit), notes
        )
    for held in content.held:
        unit = units.of(held.unit)
        yield from _parameter(words[held.name], held.column, repr(held.value), unit, [f"input, {words.about(held)}"])
    for each in content.tables:
        unit = units.of(each.unit)
        yield from _parameter(
            words[each.name], each.column, "", unit, [f"input, {words.about(each)}"], is_constant=False
        )
    yield "    </listOfParameters>"


def _parameter(
    name: str, title: str, value: str, unit: str, notes: list[str], *, is_constant: bool = True
) -> Iterable[str]:
    kind = "true" if is_constant else "false"
    attributes = f"{_attribute('name', harmless(title))}{_attribute('value', value)}{_attribute('units', unit)}"
    text = f'      <parameter id="{name}"{attributes} constant="{kind}"'
    if not notes:
        yield f"{text}/>"
        return
    yield f"{text}>"
    yield from _notes(notes, "        ")
    yield "      </parameter>"


def _starts(content: Content, words: Wording, options: Options) -> Iterable[str]:
    if not options.has_start_parameters:
        return
    yield "    <listOfInitialAssignments>"
    for state in content.states:
        math = f"{_MATH}<ci> {start_name(words, state.name)} </ci></math>"
        yield f'      <initialAssignment symbol="{words[state.name]}">{math}</initialAssignment>'
    yield "    </listOfInitialAssignments>"


def _rules(content: Content, words: Wording, time: str) -> Iterable[str]:
    yield "    <listOfRules>"
    for each in content.tables:
        yield f'      <assignmentRule variable="{words[each.name]}">'
        yield f"        {_MATH}{_table(each)}</math>"
        yield "      </assignmentRule>"
    symbols = [_element(words, name, content, time) for name in content.symbols]
    for state, formula in zip(content.states, content.rates, strict=True):
        yield f'      <rateRule variable="{words[state.name]}">'
        yield f"        {_MATH}{_mathml(formula, symbols, words)}</math>"
        yield "      </rateRule>"
    yield "    </listOfRules>"


def _element(words: Wording, name: str, content: Content, time: str) -> str:
    is_time = any(each.name == name and each.kind == "time" for each in content.inputs)
    return time if is_time else f"<ci> {words[name]} </ci>"


def _mathml(formula: Formula, symbols: list[str], words: Wording) -> str:
    """Return a formula as MathML, node by node."""
    found: list[str] = []
    for place, (code, left, right, value) in enumerate(formula.program.nodes()):
        if code == VARIABLE:
            found.append(symbols[left])
        elif code == CONSTANT:
            name = formula.constants.get(place)
            found.append(_number(value) if name is None else f"<ci> {words.constant(name)} </ci>")
        else:
            found.append(_applied(code, found[left], found[right] if ARITY[code] == 2 else ""))
    return found[-1]


def _applied(code: int, left: str, right: str) -> str:
    if code == INVERSE:
        return f"<apply><divide/>{_number(1.0)}{left}</apply>"
    if code == SQUARE:
        return f"<apply><power/>{left}{_number(2.0)}</apply>"
    if code == NEGATE:
        return f"<apply><minus/>{left}</apply>"
    return f"<apply><{_NAMES[code]}/>{left}{right}</apply>"


def _number(value: float) -> str:
    mantissa, exponent, power = repr(value).partition("e")
    if exponent:
        return f'<cn type="e-notation"> {mantissa} <sep/> {int(power)} </cn>'
    return f"<cn> {mantissa} </cn>"


def _table(its: Input) -> str:
    """Return an input as cubics of the time, piece by piece, constant before and behind."""
    assert its.table is not None
    rows = its.table.tolist()
    ends = [*(row[0] for row in rows[1:]), its.until]
    parts = [f"<piece>{_number(rows[0][1])}<apply><lt/>{_TIME}{_number(rows[0][0])}</apply></piece>"]
    for row, end in zip(rows, ends, strict=True):
        begun, ended = f"<geq/>{_TIME}{_number(row[0])}", f"<lt/>{_TIME}{_number(end)}"
        inside = f"<apply><and/><apply>{begun}</apply><apply>{ended}</apply></apply>"
        parts.append(f"<piece>{_cubic(row, f'<apply><minus/>{_TIME}{_number(row[0])}</apply>')}{inside}</piece>")
    s = its.until - rows[-1][0]
    last = rows[-1][1] + s * (rows[-1][2] + s * (rows[-1][3] + s * rows[-1][4]))
    return f"<piecewise>{''.join(parts)}<otherwise>{_number(last)}</otherwise></piecewise>"


def _cubic(row: list[float], s: str) -> str:
    text = _number(row[4])
    for coefficient in reversed(row[1:4]):
        text = f"<apply><plus/>{_number(coefficient)}<apply><times/>{s}{text}</apply></apply>"
    return text


def _notes(lines: Iterable[str], indent: str) -> Iterable[str]:
    body = '<body xmlns="http://www.w3.org/1999/xhtml">'
    yield f"{indent}<notes>{body}"
    yield from (f"{indent}  <p>{escape(harmless(line))}</p>" for line in lines if line.strip())
    yield f"{indent}</body></notes>"


def _attribute(name: str, value: str) -> str:
    return f" {name}={quoteattr(value)}" if value else ""
