"""A verdict on an equation that was found."""

from benchmarks.judging.verdict import Verdict

VERDICT = Verdict(
    case="glider", seed=0, lhs="dv/dt", found=True, exact=True, is_singular=False, reason="the same form",
    expression="-0.05*v**2 - sin(theta)", complexity=8, constants_error=1e-9, function_error=1e-9, error=1e-10,
    floor=1e-11, threshold=1e-9, converged=True, why="target", epoch=1, generation=55, point_evaluations=40_000,
    equation_seconds=0.1, search_seconds=0.2, seconds=0.5, exact_on_front=None, digest="abc",
)  # fmt: skip
