"""How the service behaves: time, memory, faults, many workers, many jobs.

``scaling`` and ``scale`` (``simulated_islands``, ``island_samples``, ``watching``) measure workers and the coordinator,
``checkpoints`` their cost, ``faults`` (``strikes``) real faults, ``soak`` (``trend``) an hour of use,
``many_jobs`` and ``big_data`` load, ``digests`` and ``same_results``
(``small_jobs``, ``differences``) equality of results, ``fuzz`` hostile messages;
``seconds`` is a stopwatch for the command.
"""
