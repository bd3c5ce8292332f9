"""The experiments that are worth most, as they are said."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from atoll.analysis.plain_data import attributes, plain
from atoll.experiments.odds import certainty_text, which_of_two
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.quoting import enumerated, first_lines

if TYPE_CHECKING:
    import polars

SCHEMA: Final = 1

Cost = Literal["trajectory", "duration", "samples"]
"""What an experiment costs: as much as any other, its duration, or its samples."""
COSTS: Final[tuple[str, ...]] = get_args(Cost)
Purpose = Literal["discrimination", "precision"]
"""To tell candidates apart, or to determine the constants of the only one."""


_SURE: Final = 0.95
"""From which probability on an experiment counts as telling two candidates apart."""
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
        return f"{self.origin}, Δ description length {self.longer:.3g}"


@dataclass(frozen=True)
class Suggestion:
    """An experiment: a trajectory from the `initial` state with constant `inputs`, measured at `times`.

    `information` in nats is what its outcome is expected to tell, about which candidate is right or of the constants;
    `evidence` how many nats the right candidate is expected to gain on the others, 2,000 at most. `worth` is what
    experiments are ranked by, over their cost: the evidence, of each pair of candidates as much as decides, or the
    information about constants. `worst` is the constant of largest relative error, with that error before and after
    the experiment (None where candidates are told apart). `certainties` are the probabilities, at least, of telling the
    first candidate from each other one rightly after the experiment, if one of the two is right; empty where constants
    are determined. `remark` says where the start lies outside of what was measured, "" where it does not.
    """

    initial: Mapping[str, float]
    inputs: Mapping[str, float]
    times: tuple[float, ...] = field(repr=False)
    cost: float
    worth: float
    information: float
    evidence: float
    worst: tuple[str, float, float] | None = None
    certainties: tuple[float, ...] = ()
    remark: str = ""

    @property
    def certainty_text(self) -> str:
        """Which candidates are told apart, and how surely; "" where constants are determined."""
        if not self.certainties:
            return ""
        if len(self.certainties) == 1:
            return f"which of the two is right is known then with {certainty_text(self.certainties[0])} certainty"
        apart = [place for place, sure in enumerate(self.certainties, start=2) if sure >= _SURE]
        rest = [place for place, sure in enumerate(self.certainties, start=2) if sure < _SURE]
        parts = []
        if apart:
            least = min(self.certainties[place - 2] for place in apart)
            each = " each" if len(apart) > 1 else ""
            named = enumerated([*map(str, apart)])
            parts.append(f"tells 1 from {named} with {certainty_text(least)} certainty{each}")
        if rest:
            parts.append(f"does not surely tell 1 from {enumerated([*map(str, rest)])}")
        return ", ".join(parts)

    @property
    def worth_per_cost(self) -> float:
        """What it is ranked by, nats per unit of its cost."""
        return self.worth / self.cost

    @property
    def initial_text(self) -> str:
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
        told_apart = attributes(self, "certainties", "remark")
        return plain(of_trajectory | gain | {"worst_constant": worst} | told_apart)


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
            where, samples = experiment.initial_text, experiment.samples_text
            lines.append(f"experiment {number}: {where}; {samples}; {self._worth(experiment)}")
            lines += [f"  warning: {experiment.remark}"] if experiment.remark else []
        return "\n".join(lines)

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    @property
    def verdict(self) -> str:
        """Which of the two likeliest candidates the data favour so far, and how strongly; "" of one alone."""
        if len(self.candidates) < 2:
            return ""
        first, second = self.candidates[:2]
        return which_of_two("candidate 1", "candidate 2", second.nats - first.nats)

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return the experiments, a row each: initial state and inputs by name, `since`, `until`, `samples`, `cost`, …

        As a frame of ``"polars"`` or ``"pandas"``; raises UsageError if it is missing.
        """
        experiments = self.experiments
        names = [*experiments[0].initial, *experiments[0].inputs] if experiments else []
        columns: dict[str, list[object]] = {
            name: [{**each.initial, **each.inputs}[name] for each in experiments] for name in names
        }
        columns["since"] = [each.times[0] for each in experiments]
        columns["until"] = [each.times[-1] for each in experiments]
        columns["samples"] = [len(each.times) for each in experiments]
        for name in ("cost", "information", "remark"):
            columns[name] = [getattr(each, name) for each in experiments]
        return frame_of(columns, library)

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
        return [*lines, *filter(None, [self.verdict])]

    def _worth(self, experiment: Suggestion) -> str:
        per = "" if self.cost == "trajectory" else f" ({experiment.worth_per_cost:.3g} per unit of {self.cost})"
        if experiment.worst is None:
            doubt = min(experiment.information / self.entropy, 1.0) if self.entropy > 0.0 else 0.0
            return f"{experiment.certainty_text}; resolves {100.0 * doubt:.0f} % of the doubt{per}"
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
