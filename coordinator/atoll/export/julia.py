"""Julia: a system of ModelingToolkit, which BifurcationKit, StructuralIdentifiability and Attractors take as well."""

from typing import Final

from atoll.export.language import Language
from atoll.export.naming import Naming
from atoll_core.expression.text.infix import Notation

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
    name="Julia",
    notation=Notation(cotangent="cot"),
    naming=Naming(frozenset(_WORDS.split()), ("table_", "along_")),
    time="t",
    comment="#",
    remark="  # {}",
    where_undefined="a rate is not finite or an error is raised, and the solver ends with a return code",
    has_noise=True,
    usage="""\
$if process:Needs the packages ModelingToolkit (10 or later) and StochasticDiffEq.
$unless process:
$if states:Needs the packages ModelingToolkit (10 or later) and OrdinaryDiffEq.
$end
""",
    regression="""\
# $target
function value(<<inputs|$name>>)
$for constants:    $name = $value$remark
    return $formula
end
""",
    motion="""\
$if process:using ModelingToolkit, StochasticDiffEq
$unless process:using ModelingToolkit, OrdinaryDiffEq
using ModelingToolkit: t_nounits as t, D_nounits as D

$for constants:@parameters $name = $value$remark
$for held:@parameters $name = $value  # input, $about
$if tables:

# An input at a time: cubic between the times of its table, constant beyond.
function along(table, until, time)
    time = clamp(time, table[1, 1], until)
    row = searchsortedlast(view(table, :, 1), time)
    s = time - table[row, 1]
    return table[row, 2] + s*(table[row, 3] + s*(table[row, 4] + s*table[row, 5]))
end
$for tables:

# $about
const table_$name = [
$for cubics:    $since $c0 $c1 $c2 $c3
]
along_$name(time::Real) = along(table_$name, $until, time)
@register_symbolic along_$name(time)
$name = along_$name(t)
$end

$end
$for states:@variables $name(t) = $start  # $about
$if process:

@brownians <<states|$normal| >>
$for noise:$name = $expression
$end

equations = [
$for states,:    D($name) ~ $rate<<terms| + $root*$factor|>>
]
@named system = System(equations, t)
model = mtkcompile(system)

$if process:
problem = SDEProblem(model, [], ($first_time, $last_time))
solution = solve(problem, EM(); dt = $substep, saveat = range($first_time, $last_time; length = $rows))
$end
$unless process:
tolerances = Dict(<<states|string($name) => $least>>)
least = [tolerances[string(state)] for state in unknowns(model)]  # in the order of the compiled system
problem = ODEProblem(model, [], ($first_time, $last_time))
solution = solve(problem, Vern9(); abstol = least, reltol = 1e-12, \
saveat = range($first_time, $last_time; length = $rows))
$end

println("$header")
for row in eachindex(solution.t)
    println(join((solution.t[row], <<states|solution[$name][row]>>), ","))
end
""",
)
