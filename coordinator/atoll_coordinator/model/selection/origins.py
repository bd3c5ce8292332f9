"""Where equations come from: the search, what was known beforehand, libraries, or the way from there. Pure."""

from collections.abc import Mapping, Sequence

from atoll.expression.program import Program, structure
from atoll.search.pareto import FrontEntry
from atoll_coordinator.data.prior_knowledge import guessed_programs
from atoll_coordinator.model.refinement import Origin, Pool
from atoll_coordinator.model.selection.joint_search import Field
from atoll_coordinator.model.structure.algebra import tidied


class Origins:
    """The origins of the programs of each variable, told by their structures: the first that has it counts.

    A program of none of these structures was made of them by leaving out, adding or changing parts.
    """

    def __init__(self, field: Field, pools: Mapping[str, Pool], lists: Sequence[Sequence[Program]]) -> None:
        """`lists` are the candidates of each variable of `field` as they were compared, libraries among them."""
        guesses = guessed_programs(field.dataset, field.config)
        self._known = frozenset(field.known)
        self._found = {
            name: _structures(
                {
                    "front": _programs(field, pools[name].front if name in pools else ()),
                    "runner-up": _programs(field, pools[name].runners_up if name in pools else ()),
                    "guess": guesses.get(name, ()),
                    "library": its if len(its) > 1 else (),
                }
            )
            for name, its in zip(field.variables, lists, strict=True)
        }

    def of(self, variable: str, program: Program) -> Origin:
        """Return the origin of `program`, before its constants were made simple, as the equation of `variable`."""
        if variable in self._known:
            return "known"
        return self._found.get(variable, {}).get(structure(tidied(program)), "descent")


def _programs(field: Field, entries: Sequence[FrontEntry]) -> list[Program]:
    return [Program.from_bytes(entry.program, len(field.dataset.names)) for entry in entries]


def _structures(programs: Mapping[Origin, Sequence[Program]]) -> dict[bytes, Origin]:
    found: dict[bytes, Origin] = {}
    for origin, its in programs.items():
        for program in its:
            found.setdefault(structure(tidied(program)), origin)
    return found
