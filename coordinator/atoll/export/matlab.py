"""MATLAB and Octave: a function that solves by ode45, with the rates beside it."""

from typing import Final

from atoll.export.language import Language
from atoll.export.naming import Naming
from atoll_core.expression.operators import LOG, SQRT
from atoll_core.expression.text.infix import Notation

_WORDS: Final = (
    "break case catch classdef continue else elseif end for function global if otherwise parfor persistent return "
    "spmd switch try while do until endif endfor endfunction endwhile unwind_protect end_try_catch properties "
    "methods events enumeration arguments ans pi eps inf Inf nan NaN i j e nargin nargout varargin varargout true "
    "false sin cos tan cot exp reallog realsqrt realpow abs tanh atoll_model last rates along t state rate "
    "options table times ppval mkpp linspace ode45 odeset fprintf numel min max value isempty clear"
)

LANGUAGE: Final = Language(
    name="MATLAB",
    notation=Notation(  # the plain functions would go on with complex numbers, where the real ones end with an error
        {LOG: "reallog", SQRT: "realsqrt"}, power="realpow({0}, {1})", natural="{0}^{1}", is_call=True, cotangent="cot"
    ),
    naming=Naming(frozenset(_WORDS.split()), ("along_",), longest=63),
    time="t",
    comment="%",
    remark=" % {}",
    where_undefined="ode45 ends early, or with an error where a number would become complex",
    usage="Save as atoll_model.m. [t, x] = atoll_model(last) solves by ode45, one column of x for each state; "
    "without results it prints CSV. For a stiff model write ode15s in place of ode45.",
    regression="""\
function value = atoll_model(<<inputs|$name>>)
$for constants:    $name = $value;$remark
    value = $formula;
end
""",
    motion="""\
function [t, x] = atoll_model(last)
    if nargin < 1, last = $last_time; end
    times = linspace($first_time, last, $rows);
    options = odeset('RelTol', 1e-12, 'AbsTol', [<<states|$least>>]);
    [t, x] = ode45(@rates, times, [<<states|$start>>], options);
    if nargout == 0
        fprintf('$header\\n');
        fprintf('%.17g<<states|,%.17g|>>\\n', [t, x].');
        clear t x
    end
end

function rate = rates(t, state)
$for states:    $name = state($number); % $about
$for constants:    $name = $value;$remark
$for held:    $name = $value; % input
$for tables:    $name = along_$name(t);
    rate = [
$for states:        $rate;
    ];
end
$for tables:

function value = along_$name(t)  % cubic between the times of a table, constant beyond
    persistent table
    if isempty(table)
        table = mkpp([<<cubics|$since>>, $until], [
$for cubics:        $c3, $c2, $c1, $c0;
        ]);
    end
    value = ppval(table, min(max(t, $since), $until));
end
$end
""",
)
