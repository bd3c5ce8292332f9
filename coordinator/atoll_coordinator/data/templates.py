"""The template of a job: the given equations of its configuration, over the symbols of its dataset. Pure."""

import math
from collections.abc import Mapping, Sequence

from atoll_core.config import JobConfig, ParameterConfig
from atoll_core.expression.template import Parameter, Template, read_template


def template_of(config: JobConfig, names: Sequence[str]) -> Template | None:
    """Return the template over the symbols `names`; None if no equation is given with ``--equation``.

    `config` is resolved: its equations are keyed by variable.

    Raises:
        UsageError: see `read_template`.
    """
    prior = config.prior
    if not prior.equations and not prior.parameters:
        return None
    return read_template(prior.equations, parameters_of(prior.parameters), names)


def parameters_of(given: Mapping[str, ParameterConfig]) -> dict[str, Parameter]:
    """Return the parameters of a configuration, by name."""
    return {
        name: Parameter(
            name,
            -math.inf if one.lower is None else one.lower,
            math.inf if one.upper is None else one.upper,
            one.start,
            one.by_group,
        )
        for name, one in given.items()
    }
