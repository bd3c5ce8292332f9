"""Modelica: a model for OpenModelica, Dymola and others, which make FMUs of it."""

from typing import Final

from atoll.export.language import Language
from atoll.export.naming import Naming
from atoll_core.expression.text.infix import Notation

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
    name="Modelica",
    notation=Notation(),
    naming=Naming(frozenset(_WORDS.split()), ("along_",)),
    time="time",
    comment="//",
    remark=' "{}"',
    where_undefined="the tool ends the simulation",
    motion="""\
model AtollModel
$for tables:
  function along_$name "cubic between the times of a table, constant beyond"
    input Real t;
    output Real value;
  protected
    constant Real table[$cubics, 5] = [
$for cubics;:      $since, $c0, $c1, $c2, $c3
    ];
    Real s;
    Integer row;
  algorithm
    row := 1;
    s := min(max(t, $since), $until);
    while row < $cubics and table[min(row + 1, $cubics), 1] <= s loop
      row := row + 1;
    end while;
    s := s - table[row, 1];
    value := table[row, 2] + s*(table[row, 3] + s*(table[row, 4] + s*table[row, 5]));
  end along_$name;
$end
$for constants:  parameter Real $name = $value$remark;
$for held:  parameter Real $name = $value "input, $about";
$for tables:  Real $name "input, $about";
$for states:  Real $name(start = $start, fixed = true, nominal = $nominal) "$about";
equation
$for tables:  $name = along_$name(time);
$for states:  der($name) = $rate;
  annotation(experiment(StartTime = $first_time, StopTime = $last_time, Interval = $step, Tolerance = 1e-12));
end AtollModel;
""",
)
