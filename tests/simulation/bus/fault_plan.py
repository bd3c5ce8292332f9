"""What goes wrong in a simulated network: a plan of faults, carried out by `tests.simulation.bus.network`."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Partition:
    """`name` is cut from the router in [start_s, end_s)."""

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Crash:
    """`name` dies at `at_s` without a word."""

    name: str
    at_s: float


@dataclass(frozen=True, slots=True)
class Plan:
    """Which faults there are. Delays are drawn uniformly from `delay_s`, or with probability `late` from `late_s`.

    `drop` is the probability that a put, a question or an answer is lost; `duplicate` that a put comes twice (more than
    the promises of a bus allow, for participants that should bear even that); `detection_s` is how long it takes until
    the others are told that a participant died or was cut off; `lease_s` how long a participant that hangs keeps its
    line; what a participant said in the last `unsent_s` before it died is lost.
    """

    delay_s: tuple[float, float] = (0.0002, 0.002)
    late: float = 0.0
    late_s: tuple[float, float] = (0.1, 1.0)
    drop: float = 0.0
    duplicate: float = 0.0
    detection_s: float = 0.002
    lease_s: float = 4.0
    unsent_s: float = 0.0
    partitions: tuple[Partition, ...] = ()
    crashes: tuple[Crash, ...] = ()
