"""What the simulated tests are made of: a whole service in virtual time, and faults that strike it.

`simulated_cluster` has the programs on the simulated bus, with `stub_islands` in place of real ones, and a world of
them with a client, which most tests use; `short_jobs` configures what they search. For faults drawn from a seed,
`schedule` says what goes wrong and when, and `participants` are the same programs on a `simulated_disk`, watched more
closely. `fault_injector` carries the faults out, `schedule_run` plays a schedule to its end and tells what must not
have happened, `shrink` leaves out of a failing schedule what it does not need to fail.
"""
