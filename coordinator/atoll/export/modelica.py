"""Modelica: a model for OpenModelica, Dymola and others, which make FMUs of it."""

from typing import Final

from atoll.export.content import Content, Language, Wording, refuse_noise, refuse_regression
from atoll.export.naming import Naming
from atoll_core.expression.text.notation import MODELICA

_WORDS: Final = (
    "algorithm and annotation assert block break class connect connector constant constrainedby der discrete each "
    "else elseif elsewhen encapsulated end enumeration equation expandable extends external false final flow for "
    "function if import impure in initial inner input loop model not operator or outer output package parameter "
    "partial protected public pure record redeclare replaceable return stream then true type when while within "
    "time Real Integer Boolean String abs sign sqrt div mod rem ceil floor integer sin cos tan asin acos atan "
    "sinh cosh tanh exp log log10 pre edge change reinit sample smooth noEvent semiLinear delay cardinality "
    "homotopy terminate AtollModel along table start fixed annotation experiment nominal"
)

LANGUAGE: Final = Language(
    MODELICA,
    Naming(frozenset(_WORDS.split()), ("along_",)),
    "time",
    "//",
    "the tool ends the simulation",
)

_LEAST_NOMINAL: Final = 1e-30
"""Of the initial value: tools divide by nominal values, whose squares are to be numbers."""


def write(content: Content) -> str:
    """Return the source of a model. Raises UsageError for a process and for a regression."""
    refuse_noise(content, "Modelica")
    refuse_regression(content, "Modelica")
    words = Wording(content, LANGUAGE)
    lines = [*words.heading(), "", "model AtollModel", *_tables(words)]
    given = [(words[each], each.value, words.note(each)) for each in content.constants]
    given += [(words[each.name], each.value, f"input, {words.about(each)}") for each in content.held]
    lines += [f"  parameter Real {name} = {value!r}{_said(note)};" for name, value, note in given]
    lines += [f"  Real {words[each.name]}{_said('input, ' + words.about(each))};" for each in content.tables]
    for state, begin, size in zip(content.states, content.start, content.sizes, strict=True):
        its = f"start = {begin!r}, fixed = true, nominal = {max(size, _LEAST_NOMINAL * abs(begin))!r}"
        lines.append(f"  Real {words[state.name]}({its}){_said(words.about(state))};")
    lines += ["equation", *(f"  {words[each.name]} = along_{words[each.name]}(time);" for each in content.tables)]
    lines += [f"  der({name}) = {text};" for name, text in zip(words.states, words.rates, strict=True)]
    interval = (content.end - content.begin) / content.steps
    times = f"StartTime = {content.begin!r}, StopTime = {content.end!r}, Interval = {interval!r}, Tolerance = 1e-12"
    return "\n".join([*lines, f"  annotation(experiment({times}));", "end AtollModel;"]) + "\n"


def _said(text: str) -> str:
    """Return a text beside a declaration."""
    quoted = text.replace('"', "'")
    return f' "{quoted}"' if text else ""


def _tables(words: Wording) -> list[str]:
    lines: list[str] = []
    for each in words.content.tables:
        assert each.table is not None
        rows = [f"      {', '.join(map(repr, row))}" for row in each.table.tolist()]
        first = each.table[0, 0]
        lines += [f'  function along_{words[each.name]} "cubic between the times of a table, constant beyond"']
        lines += ["    input Real t;", "    output Real value;", "  protected"]
        lines += [f"    constant Real table[{len(rows)}, 5] = [", ";\n".join(rows), "    ];"]
        lines += ["    Real s;", "    Integer row;", "  algorithm", "    row := 1;"]
        lines += [f"    s := min(max(t, {float(first)!r}), {each.until!r});"]
        lines += [
            f"    while row < {len(rows)} and table[min(row + 1, {len(rows)}), 1] <= s loop",
            "      row := row + 1;",
            "    end while;",
        ]
        lines += ["    s := s - table[row, 1];"]
        lines += ["    value := table[row, 2] + s*(table[row, 3] + s*(table[row, 4] + s*table[row, 5]));"]
        lines += [f"  end along_{words[each.name]};"]
    return lines
