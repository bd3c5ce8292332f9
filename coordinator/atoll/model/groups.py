"""Groups of trajectories that differ in constants: which there are, and the result of one of them."""

from atoll_coordinator.result.equations import Equation
from atoll_coordinator.result.findings import Group, Noise
from atoll_coordinator.result.result import Result


def differing_groups(result: Result) -> tuple[str, ...]:
    """Return the groups of trajectories of a result; none where no constant differs between them."""
    is_different = any(map(_differs, result.equations))
    return tuple(group.group for group in result.groups) if is_different else ()


def _differs(equation: Equation) -> bool:
    """Tell whether an equation has a constant that is not the same in all groups."""
    if equation.constants and all(constant.shared for constant in equation.constants):
        return False  # the mean of equal numbers may have another last bit
    return any(group.expression != equation.expression for group in equation.groups)


def remark_on_groups(result: Result) -> str:
    """Return a line that says of which group the constants in equations are, or of which groups they are means.

    Members of fronts and candidates have constants of all groups together. "" where there are no groups.
    """
    together = ", ".join(equation.lhs for equation in result.equations if equation.is_of_all_groups)
    if result.group is not None:
        others = f"; those of {together} are of all groups together" if together else ""
        return f"Constants are those of group {' '.join(result.group.split())}{others}."
    if together:
        return f"Constants of {together} are of all groups together, which may differ in them."
    names = " ".join(", ".join(differing_groups(result)).split())
    return f"Constants that differ between groups are means over them; the groups are {names}." if names else ""


def of_group(result: Result, group: Group) -> Result:
    """Return a result with the constants and the trajectories of one `group` of its groups alone, named as `group`."""
    taken: dict[str, object] = {"covariance": group.covariance, "groups": (), "group": group.group}
    taken["equations"] = tuple(_of_group(equation, group.group) for equation in result.equations)
    if result.simulation is not None:
        simulated = tuple(part for part in result.simulated if part.name in group.trajectories)
        taken["simulation"] = result.simulation.model_copy(update={"trajectories": simulated})
    if result.data is not None and result.data.trajectories is not None:
        recorded = tuple(part for part in result.recorded if part.name in group.trajectories)
        taken["data"] = result.data.model_copy(update={"trajectories": recorded})
    alone = result.model_copy(update=taken)
    rows = _searched_rows(result)
    if not rows:
        return alone
    share = _searched_rows(alone) / rows
    noise = {state: _with_share(known, share) for state, known in result.noise.items()}
    return alone.model_copy(update={"noise": noise})


def _of_group(equation: Equation, name: str) -> Equation:
    group = next((group for group in equation.groups if group.group == name), None)
    taken: dict[str, object] = {"groups": ()}
    if group is not None:
        taken |= {"expression": group.expression, "program": group.program, "constants": group.constants}
    return equation.model_copy(update=taken)


def _with_share(noise: Noise, share: float) -> Noise:
    """Return noise with as many independent rows as a share of the trajectories has, of those of all."""
    errors = noise.errors
    if errors is None or not errors.independent_rows:
        return noise
    fewer = errors.model_copy(update={"independent_rows": errors.independent_rows * share})
    return noise.model_copy(update={"errors": fewer})


def _searched_rows(result: Result) -> int:
    return sum(part.rows or 0 for part in result.recorded if not part.held_out)
