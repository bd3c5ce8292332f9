"""Island workers on a Ray cluster: one actor on each node starts the program ``island-worker``.

The caller owns the actors, so they end with the caller. Ray restarts an actor whose process was killed. A thread polls
the list of nodes, so nodes that join later get an actor within seconds.
"""

import contextlib
import threading
from collections.abc import Mapping
from types import ModuleType
from typing import Any, Final

import ray
from ray.exceptions import ActorDiedError, RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from atoll.workers.start import Handle, MachineWorkers, ProgramOptions, WorkerProgram, drain_limit_s
from atoll_core.errors import AtollError, UnreachableError, UsageError

LOOK_S: Final = 2.0
"""Interval of polling the list of nodes, in seconds; a machine takes longer to boot, a poll takes milliseconds."""

ANSWER_LIMIT_S: Final = 10.0
"""Time limit in seconds for an actor's report on its program; an actor without a node does not answer."""


class RayIslandWorkers:
    """An actor that runs the program on its node. Only the name of this class, strings and numbers are sent there."""

    def __init__(self, options: ProgramOptions, processes: int) -> None:
        self._program = WorkerProgram(options, processes)

    def state(self) -> tuple[int, int | None]:
        """Return the number of processes and the program's exit code."""
        return self._program.processes, self._program.exit_code()

    def drain(self) -> None:
        """Hand the islands over."""
        self._program.drain()


class RayHandle(Handle):
    """The actors of one call of `start`, by node."""

    def __init__(self, options: ProgramOptions, processes: int | None, *, owns: bool) -> None:
        """Start an actor on every node; `owns`: whether `close` also closes the connection to Ray."""
        self._options = options
        self._processes = processes
        self._owns = owns
        self._actors: dict[str, Any] = {}
        self._is_over = threading.Event()
        self._follow_nodes()
        self._watch = threading.Thread(target=self._keep_following, name="following the nodes of Ray", daemon=True)
        self._watch.start()

    def machines(self) -> Mapping[str, MachineWorkers]:
        """Return the programs by node id, for actors that answer."""
        return {node: answer for node, answer in self._answers().items() if isinstance(answer, MachineWorkers)}

    def check(self) -> None:
        """Raise AtollError also if an actor could not be started."""
        for node, answer in self._answers().items():
            if isinstance(answer, ActorDiedError):
                reason = str(answer).strip().splitlines()[-1].strip()
                raise AtollError(
                    f"the island workers of the Ray node {node} could not be started ({reason}); it needs the same "
                    "version of Atoll as this machine"
                )
        super().check()

    def _answers(self) -> Mapping[str, "MachineWorkers | RayError"]:
        """Return the actors' answers within the limit, by node id."""
        asked = {node: actor.state.remote() for node, actor in [*self._actors.items()]}
        if asked:
            ray.wait([*asked.values()], num_returns=len(asked), timeout=ANSWER_LIMIT_S)
        return {node: _answer(reference) for node, reference in asked.items()}

    def close(self) -> None:
        """End the programs, then the actors, including actors without a node."""
        if self._is_over.is_set():
            return
        self._is_over.set()
        self._watch.join(ANSWER_LIMIT_S)
        ending = [self._actors[node].drain.remote() for node in self.machines()]
        if ending:
            ray.wait(ending, num_returns=len(ending), timeout=ANSWER_LIMIT_S + drain_limit_s(self._options))
        for actor in self._actors.values():
            ray.kill(actor)
        self._actors.clear()
        if self._owns:
            ray.shutdown()

    def _keep_following(self) -> None:
        while not self._is_over.wait(LOOK_S):
            with contextlib.suppress(RayError, ConnectionError):  # Ray may be unavailable for a while
                self._follow_nodes()

    def _follow_nodes(self) -> None:
        """Start actors on new nodes, and remove the actors of nodes that have left."""
        alive = {node["NodeID"]: int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]}
        for node in [*self._actors]:
            if node not in alive:
                del self._actors[node]
        for node, cores in alive.items():
            if node not in self._actors and cores:
                self._actors[node] = self._started(node, min(self._processes or cores, cores))

    def _started(self, node: str, cores: int) -> Any:
        place = NodeAffinitySchedulingStrategy(node_id=node, soft=False)
        actor = ray.remote(RayIslandWorkers).options(
            num_cpus=cores, scheduling_strategy=place, max_restarts=-1, max_task_retries=0
        )
        return actor.remote(self._options, self._processes or cores)


def _answer(reference: Any) -> "MachineWorkers | RayError":
    try:
        return MachineWorkers(*ray.get(reference, timeout=0))
    except RayError as error:
        return error


def start(client: ModuleType | str, options: ProgramOptions, processes: int | None) -> RayHandle:
    """Start the program on every node of a Ray cluster."""
    owns = isinstance(client, str) and not ray.is_initialized()
    if isinstance(client, str) and owns:
        try:
            ray.init(address=client, log_to_driver=False)
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise UnreachableError(
                f"no Ray cluster answers at {client} ({type(error).__name__}); check the address and that it runs"
            ) from error
    if not ray.is_initialized():
        raise UsageError("ray is not connected to a cluster; call ray.init() before, or give the cluster's address")
    return RayHandle(options, processes, owns=owns)
