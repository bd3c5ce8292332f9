"""The checks of an equation with a template: its unknown part and its parameters. Pure.

They are made in addition to the checks of `trajectory_checks`. An unknown part must describe more than no unknown part
and more than a constant. A parameter must be determined by the data, and its best value must lie within its bounds.
"""

from typing import ClassVar

from atoll_coordinator.model.inference.checks import Finding
from atoll_coordinator.model.inference.trajectory_checks import TrajectoryChecks
from atoll_coordinator.model.refinement import JobKind
from atoll_coordinator.settings import SETTINGS


class TemplateChecks(TrajectoryChecks):
    """The checks of an equation of a system with a template."""

    kind: ClassVar[JobKind] = "template"

    def check_unknown_part(self) -> Finding:
        """Check that the unknown part of the equation describes more than nothing or a constant in its place."""
        template = self.final.comparison.template
        unknown = None if template is None else template.unknown_of(self.name)
        if unknown is None:
            return Finding("not applicable", "no unknown part is searched in this equation")
        gain, least = self.final.gain_of_unknown_part(self.index), SETTINGS.inference.chance_nats
        if gain >= least:
            reason = f"the unknown part shortens the description by {gain:.3g} nats"
            return Finding("passed", reason, gain, least)
        reason = (
            "the system without the unknown part, or with a constant in its place, describes the data about as well "
            f"(Δ description length {gain:.2g}; {least} is needed)"
        )
        return Finding("failed", reason, gain, least)

    def check_constants(self) -> Finding | None:
        """Check that the data determine all constants and parameters, and that none lies on a bound."""
        fitted = [
            (constant, name)
            for constant, name in zip(self.shown.constants, self.shown.parameters, strict=False)
            if constant.fitted is not None
        ]
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
        return super().check_constants()

    def check_alternative_equations(self) -> Finding | None:
        """Check that no other unknown part describes the data about as well."""
        template = self.final.comparison.template
        if template is not None and template.is_given(self.name):
            return Finding("not applicable", "the form of the equation was given")
        return super().check_alternative_equations()
