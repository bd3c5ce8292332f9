"""XPPAUT: an .ode file, for phase planes and for AUTO's continuation."""

from typing import Final

from atoll.export.language import Language
from atoll.export.naming import Naming
from atoll_core.expression.operators import LOG
from atoll_core.expression.text.infix import Notation

_WORDS: Final = (
    "sin cos tan atan atan2 sinh cosh tanh exp ln log log10 delay asin acos heav sign ceil flr ran abs max min "
    "normal besselj bessely besseli erf erfc arg poisson lgamma hom_bcs sqrt mod not if then else sum of shift "
    "del_shft int t pi i j e par param number init table wiener markov global aux bndry bdry done set volterra "
    "option options special solve only export vector block order x0 arg1 arg2 arg3 arg4 arg5 arg6 arg7 arg8 arg9 "
    "ishift isdel rate arg10 arg11 arg12 arg13 arg14 arg15 arg16 arg17 arg18 arg19 arg20 mouse_x mouse_y mouse_vx "
    "mouse_vy nxxqq"
)

LANGUAGE: Final = Language(
    name="XPPAUT",
    notation=Notation({LOG: "ln"}),
    naming=Naming(frozenset(_WORDS.split()), longest=9, is_caseless=True),
    time="t",
    comment="#",
    where_undefined="it ends the integration",
    has_noise=True,
    has_tables=False,
    longest=900,  # XPPAUT reads 1024
    usage="Open with: xppaut model.ode. AUTO (File, Auto) continues fixed points and cycles. XPPAUT keeps seven digits "
    "of what it shows.",
    motion="""\
$for constants:par $name=$value
$for held:par $name=$value
$for states:init $name=$start
$if process:
$for states:wiener $normal
$for noise:$name=$expression
$end
$for states:$name'=$rate<<terms| + $root*$factor|>>
$if process:@ t0=$first_time, total=$duration, dt=$substep, njmp=100, meth=euler
$unless process:@ t0=$first_time, total=$duration, dt=$step, meth=83dp, tol=1e-12, atol=$least
@ maxstor=$reserved_rows, bounds=1e10
done
""",
)
