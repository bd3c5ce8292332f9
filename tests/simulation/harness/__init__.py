"""What the simulated tests are made of: a whole service in virtual time, and faults that strike it.

`simulated_cluster` is a coordinator, workers and a client on the simulated bus, with `stub_islands` in place of real
ones; most tests use it. For faults drawn from a seed, `schedule` says what goes wrong and when, `participants` are all
who take part, on a `simulated_disk`. `fault_injector` carries the faults out, `schedule_run` plays a schedule to its
end and tells what must not have happened, `shrink` leaves out of a failing schedule what it does not need to fail.
"""
