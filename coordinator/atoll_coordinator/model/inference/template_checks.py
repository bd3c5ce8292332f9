"""The checks of an equation with a template: its unknown part and its parameters. Pure.

They are made in addition to the checks of `trajectory_checks`. An unknown part must describe more than no unknown part
and more than a constant. A parameter must be determined by the data, and its best value must lie within its bounds.
"""

import math
from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np

from atoll_coordinator.model.inference.checks import Finding, format_percent
from atoll_coordinator.model.inference.final_model import FinalModel
from atoll_coordinator.model.inference.long_run import LongRun
from atoll_coordinator.model.inference.trajectory_checks import TrajectoryChecks
from atoll_coordinator.model.refinement import JobKind, ObservedColumn, Refined
from atoll_coordinator.result.equations import Constant
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import variables_of

_LEAST_REACHED: Final = 2
"""Fewest fits that must end at the best minimum: a minimum that is met once may be one of many."""
_DOUBT_GIVEN_TERMS: Final = "a given term may be wrong or missing, so put ? in its place, or add ?"
"""The advice if the residuals of given equations are larger than the noise, unless the job was stopped early: more rows
would not help."""


class TemplateChecks(TrajectoryChecks):
    """The checks of an equation of a system with a template or with hidden states."""

    kind: ClassVar[JobKind] = "template"

    def __init__(  # noqa: PLR0913, one more than its base class
        self, final: FinalModel, long_run: LongRun, index: int, shown: Refined, held_out_r2: float | None,
        equations: Sequence[TrajectoryChecks], errors: FloatArray | None, observed: Sequence[ObservedColumn] = (),
    ) -> None:  # fmt: skip
        """Set the model and the equation; `errors` are the standard errors of simulated columns, then of hidden states,
        by row (None: not known). `observed` are the columns that are computed from states."""
        super().__init__(final, long_run, index, shown, held_out_r2, equations)
        self.errors, self.observed = errors, observed

    def check_no_equation(self) -> Finding | None:
        """Check that the equation describes the rows better than no equation; see `check_residual_size` for advice."""
        return self._doubt_given_terms(super().check_no_equation())

    def check_residual_size(self) -> Finding | None:
        """Check that the residuals are as large as the noise; if they are larger, doubt the given terms."""
        return self._doubt_given_terms(super().check_residual_size())

    def _doubt_given_terms(self, finding: Finding | None) -> Finding | None:
        size, template = super().check_residual_size(), self.final.comparison.template
        are_doubtful = bool(template.sides) and size is not None and size.outcome == "failed"
        if finding is None or finding.outcome != "failed" or not are_doubtful:
            return finding
        return finding._replace(advice=self.check_time().advice if self.stopped else _DOUBT_GIVEN_TERMS)

    def check_hidden_state(self) -> Finding:
        """Check that the data determine the course of a hidden state."""
        measurements, most = self.measurements, SETTINGS.inference.part
        if self.index not in measurements.hidden:
            return Finding("not applicable", "its state is measured")
        if self.name in self.final.task.config.prior.by_run:
            return Finding("not applicable", "it is a parameter that differs by run")
        if self.errors is None:
            return Finding("not made", "the errors of the hidden state are not known")
        place = len(measurements.observed) + measurements.hidden.index(self.index)
        course = self.final.shown_fit.simulated[self.index]
        share = float(np.mean(self.errors[place] ** 2)) / max(float(np.var(course)), 1e-300)
        if share <= most:
            reason = f"errors are {format_percent(share)} of the variance of the hidden state"
            return Finding("passed", reason, share, most)
        size = f"{format_percent(share)} of" if share < 1.0 else "larger than"
        reason = f"the data do not determine the hidden state {self.name} (its errors are {size} its variance)"
        advice = "give initial values with --initial, parameters as numbers, or bounds"
        return Finding("failed", reason, share, most, advice=advice)

    def check_coordinates(self) -> Finding:
        """Check that the equation does not depend on the coordinates of a hidden state, for which no equation is given.

        Any invertible function of the hidden state describes the measured columns as well, with other equations.
        """
        recording = self.final.task.recording
        if self.final.comparison.template.sides or not recording.hidden:
            return Finding("not applicable", "all states are measured, or their equations are given")
        names = self.final.task.dataset.names
        used = {names[index] for index in variables_of(self.shown.program)} | {self.name}
        symbols = dict(zip(recording.states, recording.state_symbols, strict=True))
        free = [name for name in recording.hidden if name in used or symbols[name] in used]
        if not free:
            return Finding("passed", "the equation has no hidden state")
        reason = f"the data determine {' and '.join(free)} only up to a change of coordinates"
        return Finding("failed", reason, float(len(free)), 0.0)

    @property
    def _numbers(self) -> list[tuple[Sequence[Constant], Sequence[str | None]]]:
        """The constants of the equation and of the columns that are computed from states, each with the names of those
        that are parameters."""
        own = self.shown.constants, self.shown.parameters
        return [own, *((column.constants, column.parameters) for column in self.observed)]

    def check_unknown_part(self) -> Finding:
        """Check that the unknown part of the equation describes more than nothing or a constant in its place."""
        if self.final.comparison.template.unknown_of(self.name) is None:
            return Finding("not applicable", "no unknown part is searched in this equation")
        gain, least = self.final.gain_of_unknown_part(self.index), SETTINGS.inference.chance_nats
        if gain >= least:
            reason = f"the unknown part shortens the description by {gain:.3g} nats"
            if math.isinf(gain):
                reason = "the system cannot be simulated without the unknown part, or with a constant in its place"
            return Finding("passed", reason, gain, least)
        reason = (
            "the system without the unknown part, or with a constant in its place, describes the data about as well "
            f"(Δ description length {gain:.2g}; {least} is needed)"
        )
        return Finding("failed", reason, gain, least)

    def check_starting_values(self) -> Finding:
        """Check that the fits from many starts agree on one minimum, so that a better one is unlikely.

        Another minimum contradicts it if it describes the rows about as well, and has a parameter that is outside of
        its 95 % interval. Parameters that the data do not determine are not counted: `check_constants` reports them.
        """
        minima, template = self.final.task.minima, self.final.comparison.template
        if not template.sides:
            return Finding("not applicable", "no equation was given")
        if minima is None:
            return Finding("not applicable", "the parameters were estimated from derivatives")
        if minima.starts == 1:
            reason = "the fit began from one start only, since no parameter or initial value has bounds"
            return Finding("not made", reason, advice="give bounds with --parameter or --initial")
        if minima.reached < _LEAST_REACHED:
            reason = (
                f"only one of {minima.starts} fits from different starts reached the best fit: a better one may exist"
            )
            return Finding("not made", reason, advice="give narrower bounds with --parameter, or start values")
        known = {
            name: constant.interval
            for constants, names in (
                *self._numbers,
                *((other.shown.constants, other.shown.parameters) for other in self.equations),
            )
            for constant, name in zip(constants, names, strict=False)
            if name is not None and constant.interval is not None and constant.identifiable
        }
        for nats, values in self.final.other_minima:
            for parameter, value in zip(template.parameters, values.tolist(), strict=True):
                low, high = known.get(parameter.name, (None, None))
                is_rival = nats < SETTINGS.inference.distinct_nats
                if is_rival and low is not None and high is not None and not low <= value <= high:
                    reason = (
                        f"another fit describes the rows about as well ({nats:.2g} nats) with {parameter.name} = "
                        f"{value:.3g}"
                    )
                    return Finding("failed", reason, nats, SETTINGS.inference.distinct_nats)
        reason = f"{minima.reached} of {minima.starts} fits from different starts reached the best fit"
        if not self.final.has_forms_of_starts:
            reason += ", with other functions as unknown parts; the equations were fitted from its other minima only"
        return Finding("passed", reason)

    def check_constants(self) -> Finding | None:
        """Check that the data determine all constants and parameters, and that none lies on a bound.

        A column that is computed from states is part of the model of each state, so its parameters count, too.
        """
        if not self.final.comparison.template.sides:
            return super().check_constants()
        fitted = [
            (constant, name)
            for constants, names in self._numbers
            for constant, name in zip(constants, names, strict=False)
            if constant.fitted is not None
        ]
        loose_run = self._check_runs()
        if loose_run is not None:
            return loose_run
        if not fitted:
            return Finding("not applicable", "no number of the equation is fitted")
        for constant, name in fitted:
            if name is not None and constant.at_bound:
                reason = f"the best value of the parameter {name} lies beyond its bound {constant.value or 0.0:.3g}"
                return Finding("failed", reason, advice=f"widen the bounds with --parameter {name}=…")
        loose = [name for constant, name in fitted if name is not None and not constant.identifiable]
        if loose:
            one = len(loose) == 1
            names = " and ".join(loose)
            reason = f"the parameter{'' if one else 's'} {names} {'is' if one else 'are'} not determined by the data"
            return Finding("failed", reason, float(len(loose)), 0.0, advice="give a number for one of them, or bounds")
        if not any(constant.fitted is not None for constant in self.shown.constants):
            return Finding("passed", "all parameters of computed columns are determined by the data", 0.0, 0.0)
        return super().check_constants()

    def _check_runs(self) -> Finding | None:
        """Return the first fault of a parameter that differs by run; None if there is none, and for other equations.

        Held-out trajectories do not count, since they did not determine the equations.
        """
        programs = [self.shown.program, *(column.program for column in self.observed)]
        used = {self.final.task.dataset.names[index] for program in programs for index in variables_of(program)}
        owners = [one for one in (self, *self.equations) if one is self or one.name in used]
        values = [(one.name, value) for one in owners for value in one.shown.runs if not value.held_out]
        for name, one in values:
            if not one.identifiable:
                reason = f"the rows of run {one.run} do not determine its value of the parameter {name}"
                return Finding("failed", reason, 1.0, 0.0, advice="let the runs share it, or leave this run out")
            if one.at_bound:
                reason = f"the best value of {name} in run {one.run} lies beyond its bound {one.estimate:.3g}"
                return Finding("failed", reason, advice=f'widen the bounds with --parameter "{name}=… by run"')
        return Finding("passed", "the rows of each run determine its value", 0.0, 0.0) if self.shown.runs else None

    def check_alternative_equations(self) -> Finding | None:
        """Check that no other unknown part describes the data about as well."""
        if self.final.comparison.template.is_given(self.name):
            return Finding("not applicable", "the form of the equation was given")
        return super().check_alternative_equations()
