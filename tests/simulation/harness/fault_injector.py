"""Carries out the faults of a schedule: strikes whom it names, and undoes it all at the horizon."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from atoll_core.task_frames import Failure
from tests.simulation.harness.fault_schedule import Fault
from tests.simulation.harness.participants import USUAL_BACKGROUND_S, Participants
from tests.simulation.harness.stub_islands import StubCompute


class FaultInjector:
    """Strikes the participants as their schedule says. `struck` counts by kind what had an effect."""

    def __init__(self, participants: Participants) -> None:
        self.struck: Counter[str] = Counter()
        self._participants = participants
        self._storms: list[float] = []
        for fault in participants.schedule.faults:
            participants.at(fault.at_s, partial(self._strike, fault))
        participants.at(participants.schedule.horizon_s, self.end_faults)

    def _strike(self, fault: Fault) -> None:
        if self._participants.is_over:
            return
        strike = getattr(self, "_strike_" + fault.kind.replace("-", "_"))
        has_struck = strike(fault) is not False
        self._participants.note(f"{str(fault).strip()}{'' if has_struck else ' (without effect)'}")
        if has_struck:
            self.struck[fault.kind] += 1

    def end_faults(self) -> None:
        """Undo what is wrong, and see that somebody is there to compute."""
        if self._participants.is_over:
            return
        self._participants.is_over = True
        self._participants.note("all faults are over")
        self._participants.network.plan = replace(self._participants.schedule.plan, drop=0.0, duplicate=0.0, late=0.0)
        self._participants.disk.slow_s, self._participants.background_s = 0.0, USUAL_BACKGROUND_S
        self._participants.disk.is_full = False
        self._participants.fate.coming.clear()
        self._participants.disk.forget_death()
        for name in self._participants.network.participants:
            self._participants.network.resume(name)
            self._participants.network.heal(name)
        for compute in self._participants.computes.values():
            compute.go_on()
            compute.slowness = min(compute.slowness, self._participants.schedule.slowness)
        self._participants.start_router()
        self._participants.start_coordinator()
        self._participants.see_to_workers()

    def _for_a_while(self, fault: Fault, end: Callable[[], object]) -> None:
        self._participants.at(self._participants.network.now + fault.for_s, end)

    def _set(self, fault: Fault, thing: object, name: str, value: float, afterwards: float) -> None:
        """Set an attribute for as long as the fault lasts."""
        setattr(thing, name, value)
        self._for_a_while(fault, lambda: setattr(thing, name, afterwards))

    def _strike_kill(self, fault: Fault) -> bool | None:
        if fault.who not in self._participants.workers:
            return False
        self._participants.crash(fault.who)
        if fault.for_s:
            self._for_a_while(fault, lambda: self._participants.start_worker(fault.who))
        return None

    def _strike_hang(self, fault: Fault) -> bool | None:
        compute = self._participants.computes.get(fault.who)
        if compute is None:
            return False
        self._participants.network.hang(fault.who)
        compute.hold()
        self._for_a_while(fault, lambda: self._resume(fault.who, compute))
        return None

    def _resume(self, name: str, compute: StubCompute) -> None:
        if self._participants.computes.get(name) is compute:
            self._participants.network.resume(name)
            compute.go_on()

    def _strike_stuck(self, fault: Fault) -> bool | None:
        compute = self._participants.computes.get(fault.who)
        if compute is None:
            return False
        compute.hold()
        self._for_a_while(fault, compute.go_on)
        return None

    def _strike_slow(self, fault: Fault) -> bool | None:
        compute = self._participants.computes.get(fault.who)
        if compute is None:
            return False
        self._set(fault, compute, "slowness", compute.slowness * fault.strength, compute.slowness)
        return None

    def _strike_cut(self, fault: Fault) -> bool | None:
        if fault.who not in self._participants.network.participants:
            return False
        self._cut(fault.who, fault)
        return None

    def _cut(self, name: str, fault: Fault) -> None:
        self._participants.network.disconnect(name)
        self._for_a_while(fault, lambda: self._participants.network.heal(name))

    def _strike_join(self, fault: Fault) -> None:
        self._participants.start_worker(fault.who, fault.strength, lifetime_s=fault.for_s or None)

    def _strike_leave(self, fault: Fault) -> bool | None:
        if fault.who not in self._participants.workers:
            return False
        self._participants.workers[fault.who].leave()
        return None

    def _strike_close(self, fault: Fault) -> bool | None:
        if fault.who not in self._participants.workers:
            return False
        self._participants.dismiss(fault.who)
        return None

    def _strike_kill_coordinator(self, fault: Fault) -> bool | None:
        if self._participants.service is None:
            return False
        self._participants.kill_coordinator(fault.for_s)
        return None

    def _strike_die_before_commit(self, fault: Fault) -> None:
        self._participants.down_s = fault.for_s
        self._participants.disk.die_at(int(fault.strength), before=True)

    def _strike_die_after_commit(self, fault: Fault) -> None:
        self._participants.down_s = fault.for_s
        self._participants.disk.die_at(int(fault.strength), before=False)

    def _strike_hang_coordinator(self, fault: Fault) -> None:
        self._hang("coordinator", fault)

    def _strike_hang_router(self, fault: Fault) -> None:
        self._hang("router", fault)

    def _hang(self, name: str, fault: Fault) -> None:
        self._participants.network.hang(name)
        self._for_a_while(fault, lambda: self._participants.network.resume(name))

    def _strike_kill_router(self, fault: Fault) -> None:
        self._participants.network.crash("router")
        self._for_a_while(fault, self._participants.start_router)

    def _strike_cut_coordinator(self, fault: Fault) -> None:
        self._cut("coordinator", fault)

    def _strike_cut_client(self, fault: Fault) -> None:
        self._cut("client", fault)

    def _strike_storm(self, fault: Fault) -> None:
        self._storms.append(fault.strength)
        self._set_weather()

        def end() -> None:
            self._storms.remove(fault.strength)
            self._set_weather()

        self._for_a_while(fault, end)

    def _set_weather(self) -> None:
        if self._participants.is_over:
            return
        worst, plan = max(self._storms, default=0.0), self._participants.schedule.plan
        self._participants.network.plan = replace(
            plan, drop=max(plan.drop, worst), duplicate=max(plan.duplicate, worst), late=max(plan.late, worst)
        )

    def _strike_slow_disk(self, fault: Fault) -> None:
        self._set(fault, self._participants.disk, "slow_s", fault.strength, 0.0)

    def _strike_slow_background(self, fault: Fault) -> None:
        self._set(fault, self._participants, "background_s", fault.strength, USUAL_BACKGROUND_S)

    def _strike_crash_task(self, fault: Fault) -> None:
        self._arm(fault, "crash")

    def _strike_starve_task(self, fault: Fault) -> None:
        self._arm(fault, "memory")

    def _strike_break_task(self, fault: Fault) -> None:
        self._arm(fault, "error")

    def _strike_kill_in_task(self, fault: Fault) -> None:
        self._arm(fault, None)

    def _arm(self, fault: Fault, failure: Failure | None) -> None:
        """Have the next task meet something; tasks take long for a while, so that other faults come in between."""
        self._participants.fate.coming.append(failure)
        self._set(fault, self._participants, "background_s", fault.strength, USUAL_BACKGROUND_S)

    def _strike_full_disk(self, fault: Fault) -> None:
        self._set(fault, self._participants.disk, "is_full", True, False)

    def _strike_old_store(self, fault: Fault) -> bool | None:
        if self._participants.service is None:
            return False
        self._participants.kill_coordinator(fault.for_s)
        return None if self._participants.disk.grow_old() else False

    def _strike_clock_jump(self, fault: Fault) -> None:
        self._participants.jumped_s += fault.strength
