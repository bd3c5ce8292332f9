"""What the end of a job means: a sentence, and an exit code."""

from typing import Final

from atoll.cli.exit_codes import BAD_INPUT, DONE, FAILED, INTERRUPTED, TARGET_MISSED
from atoll_core.wire.messages.views import JobView

NOTHING_FOUND: Final = ", before it found any equation"
"""What a sentence on a cancelled job ends with that has no equations."""


def exit_code(view: JobView, target_error: float | None) -> int:
    """Return the exit code of a job that has ended; `target_error` is the user's explicit one."""
    if view.state == "failed":
        return BAD_INPUT if view.fault == "data" else FAILED
    if view.state == "cancelled":
        return INTERRUPTED
    return TARGET_MISSED if target_error is not None and _missed(view) else DONE


def ending(view: JobView, target_error: float | None) -> str | None:
    """Return the sentence that explains an exit code other than 0."""
    if view.state == "failed":
        return f"job {view.job} failed: {view.reason}"
    if view.state == "cancelled":
        kept = "; what it had found is kept" if has_found(view) else NOTHING_FOUND
        return f"job {view.job} was cancelled{kept}"
    if exit_code(view, target_error) == TARGET_MISSED:
        return f"--target-error {target_error:g} was not met within the budget by {', '.join(_missed(view))}"
    return None


def has_found(view: JobView) -> bool:
    """Tell whether a job has any equation that was searched for."""
    return any(variable.expression is not None and variable.why != "known" for variable in view.variables)


def _missed(view: JobView) -> list[str]:
    """Return the left-hand sides of the equations that were searched and have not converged."""
    return [variable.lhs for variable in view.variables if not variable.converged and variable.why != "known"]
