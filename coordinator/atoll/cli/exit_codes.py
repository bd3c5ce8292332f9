"""The exit codes of the program and of ended jobs; the exit codes of errors are in `atoll_core.errors`."""

from typing import TYPE_CHECKING, Final

from atoll.terminal.output import note
from atoll_core.signals import INTERRUPTED as INTERRUPTED

if TYPE_CHECKING:
    from atoll_core.wire.messages.views import JobView

DONE: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
TARGET_MISSED: Final = 4


def report_exit_code(view: "JobView") -> int:
    """Return the exit code of a job that has ended; if it is not 0, print the reason on stderr."""
    code, sentence = exit_code_and_reason(view)
    if sentence is not None:
        note(f"coordinator: {sentence}")
    return code


def exit_code_and_reason(view: "JobView") -> tuple[int, str | None]:
    """Return the exit code of a job that has ended, and the reason as a sentence (None with exit code 0)."""
    if view.state == "failed":
        return BAD_INPUT if view.fault == "data" else FAILED, f"job {view.job} failed: {view.reason}"
    if view.state == "cancelled":
        return INTERRUPTED, f"job {view.job} was cancelled{end_of_cancelled(view, '; its best equations are kept')}"
    missed = [each.lhs for each in view.variables if not each.converged and each.why != "known"]
    if view.target_error is None or not missed:
        return DONE, None
    equations = f"{'these equations' if len(missed) > 1 else 'the equation'}: {', '.join(missed)}"
    return TARGET_MISSED, f"--target-error {view.target_error:g} was not met within the budget for {equations}"


def end_of_cancelled(view: "JobView", kept: str) -> str:
    """Return the last clause of a sentence about a cancelled job: `kept` if the job has found an equation."""
    has_found = any(variable.expression is not None and variable.why != "known" for variable in view.variables)
    return kept if has_found else ", before it found any equation"
