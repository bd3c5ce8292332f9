"""Julia: a system of ModelingToolkit, which BifurcationKit, StructuralIdentifiability and Attractors take as well."""

from typing import Final

from atoll.export.content import Content, Language, Wording
from atoll.export.naming import Naming
from atoll_core.expression.text.notation import JULIA

_WORDS: Final = (
    "abstract baremodule begin break catch const continue do else elseif end export false finally for function "
    "global if import in isa let local macro module mutable new nothing outer primitive quote return struct true "
    "try tuple type undef using where while ans missing pi im Inf NaN sin cos tan cot exp log sqrt abs tanh t D W "
    "time along value model equations problem solution system Base Core Main row table until range solve println "
    "print zip e ModelingToolkit OrdinaryDiffEq StochasticDiffEq t_nounits D_nounits parameters variables brownians "
    "named register_symbolic System mtkcompile ODEProblem SDEProblem Vern9 EM abstol reltol saveat dt length eachindex "
    "as join Real clamp searchsortedlast view println Dict string state tolerances least unknowns"
)

LANGUAGE: Final = Language(
    JULIA,
    Naming(frozenset(_WORDS.split()), ("table_", "along_")),
    "t",
    "#",
    "a rate is not finite or an error is raised, and the solver ends with a return code",
)
_PACKAGES: Final = "Needs the packages ModelingToolkit (10 or later) and OrdinaryDiffEq."
_PACKAGES_OF_NOISE: Final = "Needs the packages ModelingToolkit (10 or later) and StochasticDiffEq."


def write(content: Content) -> str:
    """Return the source of a script; of a regression that of a function."""
    words = Wording(content, LANGUAGE)
    if not content.states:
        return "\n".join([*words.heading(), "", *_regression(words)]) + "\n"
    packages = _PACKAGES_OF_NOISE if content.covariance else _PACKAGES
    return "\n".join([*words.heading(packages), "", *_motion(words)]) + "\n"


def _regression(words: Wording) -> list[str]:
    arguments = ", ".join(words[each.name] for each in words.content.inputs)
    lines = [f"    {words[each]} = {each.value!r}" + _note(words.note(each)) for each in words.content.constants]
    return [f"# {words.target}", f"function value({arguments})", *lines, f"    return {words.rates[0]}", "end"]


def _motion(words: Wording) -> list[str]:
    its = words.content
    solver = "StochasticDiffEq" if its.covariance else "OrdinaryDiffEq"
    lines = [f"using ModelingToolkit, {solver}", "using ModelingToolkit: t_nounits as t, D_nounits as D", ""]
    constants = [(f"{words[each]} = {each.value!r}", _note(words.note(each))) for each in its.constants]
    lines += [f"@parameters {text}{note}" for text, note in constants]
    lines += [f"@parameters {words[each.name]} = {each.value!r}  # input, {words.about(each)}" for each in its.held]
    lines += _tables(words)
    for state, begin in zip(its.states, its.start, strict=True):
        lines.append(f"@variables {words[state.name]}(t) = {begin!r}  # {words.about(state)}")
    lines += [*_equations(words), "@named system = System(equations, t)", "model = mtkcompile(system)", ""]
    lines += _solution(words)
    row = ", ".join(f"solution[{name}][row]" for name in words.states)
    lines += ["", f'println("{",".join([words.time, *words.states])}")', "for row in eachindex(solution.t)"]
    return [*lines, f'    println(join((solution.t[row], {row}), ","))', "end"]


def _tables(words: Wording) -> list[str]:
    if not words.content.tables:
        return []
    lines = _ALONG.splitlines()
    for each in words.content.tables:
        assert each.table is not None
        rows = [f"    {' '.join(map(repr, row))}" for row in each.table.tolist()]
        name = words[each.name]
        lines += ["", f"# {words.about(each)}", f"const table_{name} = [", *rows, "]"]
        lines += [
            f"along_{name}(time::Real) = along(table_{name}, {each.until!r}, time)",
            f"@register_symbolic along_{name}(time)",
        ]
        lines += [f"{name} = along_{name}(t)"]
    return [*lines, ""]


def _equations(words: Wording) -> list[str]:
    rates = words.rates
    lines: list[str] = []
    if words.content.covariance:
        assignments, rows = words.noise
        lines += ["", "@brownians " + " ".join(words.normals)]
        lines += [f"{name} = {text}" for name, text in assignments]
        rates = [
            " + ".join([rate, *(f"{g}*{w}" for g, w in zip(row, words.normals, strict=True) if g)])
            for rate, row in zip(rates, rows, strict=True)
        ]
    texts = [f"    D({name}) ~ {text}" for name, text in zip(words.states, rates, strict=True)]
    return [*lines, "", "equations = [", ",\n".join(texts), "]"]


def _solution(words: Wording) -> list[str]:
    its = words.content
    span = f"({its.begin!r}, {its.end!r})"
    saved = f"range({its.begin!r}, {its.end!r}; length = {its.steps + 1})"
    if its.covariance:
        step = (its.end - its.begin) / its.steps / 100
        return [
            f"problem = SDEProblem(model, [], {span})",
            f"solution = solve(problem, EM(); dt = {step!r}, saveat = {saved})",
        ]
    tolerance = "abstol = least, reltol = 1e-12"
    pairs = ", ".join(f"string({name}) => {1e-12 * size!r}" for name, size in zip(words.states, its.sizes, strict=True))
    return [
        f"tolerances = Dict({pairs})",
        "least = [tolerances[string(state)] for state in unknowns(model)]  # in the order of the compiled system",
        f"problem = ODEProblem(model, [], {span})",
        f"solution = solve(problem, Vern9(); {tolerance}, saveat = {saved})",
    ]


def _note(text: str) -> str:
    return f"  # {text}" if text else ""


_ALONG: Final = """
# An input at a time: cubic between the times of its table, constant beyond.
function along(table, until, time)
    time = clamp(time, table[1, 1], until)
    row = searchsortedlast(view(table, :, 1), time)
    s = time - table[row, 1]
    return table[row, 2] + s*(table[row, 3] + s*(table[row, 4] + s*table[row, 5]))
end
"""
