"""The hand that carries out a schedule: strikes whom it names, and undoes it all at the horizon."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from tests.simulation.schedule import Fault
from tests.simulation.stub import StubCompute
from tests.simulation.troupe import USUAL_BACKGROUND_S, Troupe


class Hand:
    """Strikes a troupe as its schedule says. `struck` counts by kind what had an effect."""

    def __init__(self, troupe: Troupe) -> None:
        self.struck: Counter[str] = Counter()
        self._troupe = troupe
        self._storms: list[float] = []
        for fault in troupe.schedule.faults:
            troupe.at(fault.at_s, partial(self._strike, fault))
        troupe.at(troupe.schedule.horizon_s, self.end_faults)

    def _strike(self, fault: Fault) -> None:
        if self._troupe.is_over:
            return
        strike = getattr(self, "_strike_" + fault.kind.replace("-", "_"))
        has_struck = strike(fault) is not False
        self._troupe.note(f"{str(fault).strip()}{'' if has_struck else ' (without effect)'}")
        if has_struck:
            self.struck[fault.kind] += 1

    def end_faults(self) -> None:
        """Undo what is wrong, and see that somebody is there to compute."""
        if self._troupe.is_over:
            return
        self._troupe.is_over = True
        self._troupe.note("all faults are over")
        self._troupe.network.plan = replace(self._troupe.schedule.plan, drop=0.0, duplicate=0.0, late=0.0)
        self._troupe.disk.slow_s, self._troupe.background_s = 0.0, USUAL_BACKGROUND_S
        self._troupe.disk.forget_death()
        for name in self._troupe.network.participants:
            self._troupe.network.resume(name)
            self._troupe.network.heal(name)
        for compute in self._troupe.computes.values():
            compute.go_on()
            compute.slowness = min(compute.slowness, self._troupe.schedule.slowness)
        self._troupe.start_router()
        self._troupe.start_coordinator()
        self._troupe.see_to_workers()

    def _for_a_while(self, fault: Fault, end: Callable[[], object]) -> None:
        self._troupe.at(self._troupe.network.now + fault.for_s, end)

    def _strike_kill(self, fault: Fault) -> bool | None:
        if fault.who not in self._troupe.workers:
            return False
        self._troupe.crash(fault.who)
        if fault.for_s:
            self._for_a_while(fault, lambda: self._troupe.start_worker(fault.who))
        return None

    def _strike_hang(self, fault: Fault) -> bool | None:
        compute = self._troupe.computes.get(fault.who)
        if compute is None:
            return False
        self._troupe.network.hang(fault.who)
        compute.hold()
        self._for_a_while(fault, lambda: self._resume(fault.who, compute))
        return None

    def _resume(self, name: str, compute: StubCompute) -> None:
        if self._troupe.computes.get(name) is compute:
            self._troupe.network.resume(name)
            compute.go_on()

    def _strike_stuck(self, fault: Fault) -> bool | None:
        compute = self._troupe.computes.get(fault.who)
        if compute is None:
            return False
        compute.hold()
        self._for_a_while(fault, compute.go_on)
        return None

    def _strike_slow(self, fault: Fault) -> bool | None:
        compute = self._troupe.computes.get(fault.who)
        if compute is None:
            return False
        before = compute.slowness
        compute.slowness = before * fault.strength

        def end() -> None:
            compute.slowness = before

        self._for_a_while(fault, end)
        return None

    def _strike_cut(self, fault: Fault) -> bool | None:
        if fault.who not in self._troupe.network.participants:
            return False
        self._troupe.network.cut(fault.who)
        self._for_a_while(fault, lambda: self._troupe.network.heal(fault.who))
        return None

    def _strike_join(self, fault: Fault) -> None:
        self._troupe.start_worker(fault.who, fault.strength, lifetime_s=fault.for_s or None)

    def _strike_leave(self, fault: Fault) -> bool | None:
        if fault.who not in self._troupe.workers:
            return False
        self._troupe.workers[fault.who].leave()
        return None

    def _strike_close(self, fault: Fault) -> bool | None:
        if fault.who not in self._troupe.workers:
            return False
        self._troupe.dismiss(fault.who)
        return None

    def _strike_kill_coordinator(self, fault: Fault) -> bool | None:
        if self._troupe.service is None:
            return False
        self._troupe.kill_coordinator(fault.for_s)
        return None

    def _strike_die_before_commit(self, fault: Fault) -> None:
        self._troupe.down_s = fault.for_s
        self._troupe.disk.die_at(int(fault.strength), before=True)

    def _strike_die_after_commit(self, fault: Fault) -> None:
        self._troupe.down_s = fault.for_s
        self._troupe.disk.die_at(int(fault.strength), before=False)

    def _strike_hang_coordinator(self, fault: Fault) -> None:
        self._hang("coordinator", fault)

    def _strike_hang_router(self, fault: Fault) -> None:
        self._hang("router", fault)

    def _hang(self, name: str, fault: Fault) -> None:
        self._troupe.network.hang(name)
        self._for_a_while(fault, lambda: self._troupe.network.resume(name))

    def _strike_kill_router(self, fault: Fault) -> None:
        self._troupe.network.crash("router")
        self._for_a_while(fault, self._troupe.start_router)

    def _strike_cut_coordinator(self, fault: Fault) -> None:
        self._troupe.network.cut("coordinator")
        self._for_a_while(fault, lambda: self._troupe.network.heal("coordinator"))

    def _strike_cut_client(self, fault: Fault) -> None:
        self._troupe.network.cut("client")
        self._for_a_while(fault, lambda: self._troupe.network.heal("client"))

    def _strike_storm(self, fault: Fault) -> None:
        self._storms.append(fault.strength)
        self._set_weather()

        def end() -> None:
            self._storms.remove(fault.strength)
            self._set_weather()

        self._for_a_while(fault, end)

    def _set_weather(self) -> None:
        if self._troupe.is_over:
            return
        worst, plan = max(self._storms, default=0.0), self._troupe.schedule.plan
        self._troupe.network.plan = replace(
            plan, drop=max(plan.drop, worst), duplicate=max(plan.duplicate, worst), late=max(plan.late, worst)
        )

    def _strike_slow_disk(self, fault: Fault) -> None:
        self._troupe.disk.slow_s = fault.strength

        def end() -> None:
            self._troupe.disk.slow_s = 0.0

        self._for_a_while(fault, end)

    def _strike_slow_background(self, fault: Fault) -> None:
        self._troupe.background_s = fault.strength

        def end() -> None:
            self._troupe.background_s = USUAL_BACKGROUND_S

        self._for_a_while(fault, end)

    def _strike_clock_jump(self, fault: Fault) -> None:
        self._troupe.jumped_s += fault.strength
