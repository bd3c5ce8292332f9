"""MATLAB and Octave: a function that solves by ode45, with the rates beside it."""

from typing import Final

from atoll.export.content import Content, Language, Wording, refuse_noise
from atoll.export.naming import Naming
from atoll_core.expression.text.notation import MATLAB

_WORDS: Final = (
    "break case catch classdef continue else elseif end for function global if otherwise parfor persistent return "
    "spmd switch try while do until endif endfor endfunction endwhile unwind_protect end_try_catch properties "
    "methods events enumeration arguments ans pi eps inf Inf nan NaN i j e nargin nargout varargin varargout true "
    "false sin cos tan cot exp reallog realsqrt realpow abs tanh atoll_model last rates along t state rate "
    "options table times ppval mkpp linspace ode45 odeset fprintf numel min max value isempty clear"
)

LANGUAGE: Final = Language(
    MATLAB,
    Naming(frozenset(_WORDS.split()), ("along_",), longest=63),
    "t",
    "%",
    "ode45 ends early, or with an error where a number would become complex",
    "Save as atoll_model.m. [t, x] = atoll_model(last) solves by ode45, one column of x for each state; "
    "without results it prints CSV. For a stiff model write ode15s in place of ode45.",
)


def write(content: Content) -> str:
    """Return the source of a function file. Raises UsageError for a process."""
    refuse_noise(content, "MATLAB")
    words = Wording(content, LANGUAGE)
    its = _regression(words) if not content.states else _motion(words)
    return "\n".join([*words.heading(), "", *its]) + "\n"


def _regression(words: Wording) -> list[str]:
    arguments = ", ".join(words[each.name] for each in words.content.inputs)
    return [f"function value = atoll_model({arguments})", *_constants(words), f"    value = {words.rates[0]};", "end"]


def _motion(words: Wording) -> list[str]:
    its = words.content
    start = ", ".join(map(repr, its.start))
    header = ",".join([words.time, *words.states])
    lines = ["function [t, x] = atoll_model(last)", f"    if nargin < 1, last = {its.end!r}; end"]
    lines += [f"    times = linspace({its.begin!r}, last, {its.steps + 1});"]
    least = ", ".join(repr(1e-12 * size) for size in its.sizes)
    lines += [f"    options = odeset('RelTol', 1e-12, 'AbsTol', [{least}]);"]
    lines += [f"    [t, x] = ode45(@rates, times, [{start}], options);", "    if nargout == 0"]
    lines += [f"        fprintf('{header}\\n');"]
    numbers = ",".join(["%.17g"] * (len(its.states) + 1))
    lines += [
        f"        fprintf('{numbers}\\n', [t, x].');",
        "        clear t x",
        "    end",
        "end",
        "",
        "function rate = rates(t, state)",
    ]
    lines += [
        f"    {name} = state({place}); % {words.about(state)}"
        for place, (name, state) in enumerate(zip(words.states, its.states, strict=True), start=1)
    ]
    lines += [*_constants(words), *_inputs(words)]
    lines += ["    rate = [", *(f"        {text};" for text in words.rates), "    ];", "end"]
    for each in its.tables:
        assert each.table is not None
        name = words[each.name]
        rows = [f"        {', '.join(map(repr, row[:0:-1]))};" for row in each.table.tolist()]
        breaks = [*each.table[:, 0].tolist(), each.until]
        lines += ["", f"function value = along_{name}(t)  % cubic between the times of a table, constant beyond"]
        lines += [
            "    persistent table",
            "    if isempty(table)",
            f"        table = mkpp([{', '.join(map(repr, breaks))}], [",
            *rows,
        ]
        lines += [
            "        ]);",
            "    end",
            f"    value = ppval(table, min(max(t, {breaks[0]!r}), {each.until!r}));",
            "end",
        ]
    return lines


def _constants(words: Wording) -> list[str]:
    its = [(words[each], each.value, words.note(each)) for each in words.content.constants]
    return [f"    {name} = {value!r};" + (f" % {note}" if note else "") for name, value, note in its]


def _inputs(words: Wording) -> list[str]:
    lines = [f"    {words[each.name]} = {each.value!r}; % input" for each in words.content.held]
    return lines + [f"    {words[each.name]} = along_{words[each.name]}(t);" for each in words.content.tables]
