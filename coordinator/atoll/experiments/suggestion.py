"""The experiments that are worth most, as they are said."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Final, Literal, get_args

from atoll.analysis.plain_data import attributes, plain

SCHEMA: Final = 1

Cost = Literal["trajectory", "duration", "samples"]
"""What an experiment costs: as much as any other, its duration, or its samples."""
COSTS: Final[tuple[str, ...]] = get_args(Cost)
Purpose = Literal["discrimination", "precision"]
"""To tell candidates apart, or to determine the constants of the only one."""


_WEIGHTS: Final = (
    "weights are by how well the data are described alone (Akaike); the result also counts how long equations are"
)


def equations_text(equations: Mapping[str, str]) -> str:
    """Return equations, right-hand sides by left-hand side, in a line."""
    return "; ".join(f"{side} = {text}" for side, text in equations.items())


@dataclass(frozen=True)
class Candidate:
    """A candidate with its fitted constants: `equations` by left-hand side, `origin` where it comes from.

    Its `weight` among all candidates is Akaike's, by how well it describes the data alone; `nats` how far it is behind
    the best one: ln of the ratio of weights. `longer` is how many nats more than the shown one its description has,
    which is what results choose by: it also counts what the equations are made of. `written` are the equations with the
    constants of the result, where these are others; empty where not.
    """

    equations: Mapping[str, str]
    origin: str
    weight: float
    nats: float
    longer: float = 0.0
    written: Mapping[str, str] = field(default_factory=dict)

    @property
    def origin_text(self) -> str:
        """Where it comes from, and how much longer its description is than that of the equations shown."""
        if self.origin == "shown":
            return self.origin
        return f"{self.origin}, {abs(self.longer):.3g} nats {'longer' if self.longer >= 0.0 else 'shorter'}"


@dataclass(frozen=True)
class Suggestion:
    """An experiment: a trajectory from the `initial` state with constant `inputs`, measured at `times`.

    `information` in nats is what its outcome is expected to tell, about which candidate is right or of the constants;
    `evidence` how many nats the right candidate is expected to gain on the others. `worth` is what experiments are
    ranked by, over their cost: the evidence, of each pair of candidates as much as decides, or the information about
    constants. `worst` is the constant of largest relative error, with that error before and after the experiment (None
    where candidates are told apart).
    """

    initial: Mapping[str, float]
    inputs: Mapping[str, float]
    times: tuple[float, ...]
    cost: float
    worth: float
    information: float
    evidence: float
    worst: tuple[str, float, float] | None = None

    @property
    def worth_per_cost(self) -> float:
        """What it is ranked by, nats per unit of its cost."""
        return self.worth / self.cost

    @property
    def start_text(self) -> str:
        """Where it begins, and with which inputs."""
        return ", ".join(f"{name} = {value:.4g}" for name, value in {**self.initial, **self.inputs}.items())

    @property
    def samples_text(self) -> str:
        """How often and how long is measured."""
        return f"{len(self.times)} samples from {self.times[0]:.4g} to {self.times[-1]:.4g}"

    def as_dict(self) -> dict[str, object]:
        """Return it as plain data."""
        of_trajectory = attributes(self, "initial", "inputs", "times", "cost")
        gain = attributes(self, "worth", "worth_per_cost", "information", "evidence")
        heads = ("name", "relative_error", "expected_relative_error")
        worst = None if self.worst is None else dict(zip(heads, self.worst, strict=True))
        return plain(of_trajectory | gain | {"worst_constant": worst})


@dataclass(frozen=True)
class Suggestions:
    """Experiments in the order of what they tell per cost.

    `purpose` and `reason` say what for and why; `entropy` in nats is how undecided the candidates are, the most that an
    experiment can tell about them. `bounds` are what is searched of initial states and inputs; of `measured` the
    range of the smoothed data. `source` says which data.
    """

    purpose: Purpose
    reason: str
    entropy: float
    candidates: tuple[Candidate, ...]
    experiments: tuple[Suggestion, ...]
    bounds: Mapping[str, tuple[float, float]]
    measured: tuple[str, ...]
    cost: Cost
    source: str

    def __str__(self) -> str:
        lines = [*self._candidate_lines(), f"purpose: {self.purpose_text}"]
        parts = [
            f"{name} {low:.4g} to {high:.4g} ({'of the data, smoothed' if name in self.measured else 'given'})"
            for name, (low, high) in self.bounds.items()
        ]
        lines.append("searched: " + ", ".join(parts))
        for number, experiment in enumerate(self.experiments, start=1):
            where, samples = experiment.start_text, experiment.samples_text
            lines.append(f"experiment {number}: {where}; {samples}; {self._worth(experiment)}")
        return "\n".join(lines)

    @property
    def purpose_text(self) -> str:
        """What the experiments are for, and why."""
        purpose = "to tell them apart" if self.purpose == "discrimination" else "to determine constants"
        return f"{purpose}, since {self.reason}"

    def _candidate_lines(self) -> list[str]:
        lines = [f"candidates, their constants fitted again ({self.source}):"]
        for number, candidate in enumerate(self.candidates, start=1):
            origin, texts = candidate.origin_text, equations_text(candidate.equations)
            lines.append(f"  {number}. weight {candidate.weight:.2g} ({origin})  {texts}")
            if candidate.written:
                lines.append(f"     with the constants of the result  {equations_text(candidate.written)}")
        if self.candidates and self.candidates[0].origin != "shown":
            lines.append(_WEIGHTS)
        return lines

    def _worth(self, experiment: Suggestion) -> str:
        per = "" if self.cost == "trajectory" else f" ({experiment.worth_per_cost:.3g} per unit of {self.cost})"
        if experiment.worst is None:
            worth = f"{experiment.evidence:.3g} nats, {experiment.worth:.3g} of use{per}"
            told = f"the right one is expected to gain {worth}"
            return f"{told}; {experiment.information:.3g} of {self.entropy:.3g} nats of doubt resolved"
        name, before, after = experiment.worst
        shrinks = f"the error of {name} from {100 * before:.2g} to {100 * after:.2g} %"
        return f"{experiment.information:.3g} nats about the constants expected{per}, {shrinks}"

    def as_dict(self) -> dict[str, object]:
        """Return all of it as plain data, as ``coordinator suggest --json`` prints it."""
        about = {
            "schema": SCHEMA,
            **attributes(self, "purpose", "reason", "entropy"),
            "candidates": [asdict(candidate) for candidate in self.candidates],
            "bounds": self.bounds,
            "bounds_of_data": self.measured,
            "cost": self.cost,
            "data": self.source,
            "experiments": [experiment.as_dict() for experiment in self.experiments],
        }
        return plain(about)
