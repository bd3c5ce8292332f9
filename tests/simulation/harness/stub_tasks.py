"""A stub of a worker's task process: tasks run in this process, and their results come some virtual time later."""

from collections.abc import Callable

from atoll_coordinator.tasks.preparing import Preparer, prepare
from atoll_coordinator.tasks.refining import Refiner, refine
from atoll_core.tasks.frames import Begun, Failed, Finished, FromProcess, Run, ToProcess
from tests.simulation.bus.network import SimulatedNetwork

USUAL_S = 0.001


class StubTasks:
    """Runs tasks of one worker; `seconds` is how long each takes now."""

    def __init__(
        self, network: SimulatedNetwork, preparer: Preparer, refiner: Refiner,
        seconds: Callable[[], float] = lambda: USUAL_S,
    ) -> None:  # fmt: skip
        self.ran: list[Run] = []
        self._network = network
        self._preparer = preparer
        self._refiner = refiner
        self._seconds = seconds
        self._post: Callable[[object], None] = lambda message: None
        self._life = 0

    def attach(self, post: Callable[[object], None]) -> None:
        self._post = post

    @property
    def is_started(self) -> bool:
        return self._life > 0

    def send(self, message: ToProcess) -> None:
        assert isinstance(message, Run), "no batches are simulated"
        self._life += 1
        life = self._life
        self.ran.append(message)

        def act() -> None:
            if life == self._life:
                self._post(Begun(message.task))
                self._post(self._result(message))

        self._network.at(self._network.now + self._seconds(), act)

    def load_next(self, function: str) -> None:
        pass

    def stop(self) -> None:
        self._life += 1

    def stop_if_idle(self) -> None:
        pass

    def _result(self, run: Run) -> FromProcess:
        try:
            if run.function == "prepare":
                return Finished(run.task, prepare(*run.inputs, self._preparer))
            return Finished(run.task, refine(*run.inputs, run.seconds, self._refiner))
        except Exception as error:
            return Failed(run.task, "error", f"{type(error).__name__}: {error}")
