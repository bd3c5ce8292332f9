"""The other equations that were compared, each with the rest of the result."""

from atoll_coordinator.result.equations import Candidate, Equation
from atoll_coordinator.result.result import Result


def candidate_results(result: Result) -> tuple[Result, ...]:
    """Return the result with each other candidate in the place of an equation, the best first.

    Without what belongs to the model: errors, verdicts, terms in common.
    """
    others = [
        (candidate.nats, place, candidate)
        for place, equation in enumerate(result.equations)
        for candidate in equation.candidates
        if not candidate.selected and candidate.nats is not None
    ]
    return tuple(_with(result, place, other) for _, place, other in sorted(others, key=lambda ranked: ranked[0]))


def _with(result: Result, place: int, other: Candidate) -> Result:
    # constants of candidates, and of equations without their groups, are of all groups together
    equations = [
        equation.model_copy(update={"groups": (), "is_of_all_groups": bool(equation.groups)})
        for equation in result.equations
    ]
    shown = result.equations[place]
    equations[place] = Equation(  # nothing but this is known of it
        variable=shown.variable,
        lhs=shown.lhs,
        **{name: getattr(other, name) for name in ("expression", "complexity", "origin", "nats")},
        **{name: getattr(shown, name) for name in _OF_THE_SEARCH},
        is_of_all_groups=result.group is not None or bool(shown.groups),
    )
    unknown = {"covariance": None, "groups": (), "correlations": (), "shared_terms": (), "chaos": None}
    return result.model_copy(update={"equations": tuple(equations), **unknown})


_OF_THE_SEARCH = (
    "error", "normalized_error", "r2", "converged", "simple_together", "epoch", "generation", "point_evaluations",
    "point_evaluations_by_part", "seconds", "why", "derivative_floor", "target_error", "convergence", "front",
)  # fmt: skip
"""What stays beside another candidate, as it is of the search and not of the equation."""
