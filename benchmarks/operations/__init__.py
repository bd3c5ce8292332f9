"""How the service behaves: time, memory, faults, many workers.

``scaling`` and ``scale`` (``simulated_islands``, ``island_samples``) measure workers and the coordinator, ``big_data``
memory, ``faults`` (``strikes``) real faults, ``soak`` (``trend``) an hour of use; ``side_by_side`` compares times of
two revisions, ``same_results`` (``small_jobs``, ``differences``) all that they write; ``pipelines`` plays jobs of
``drawn_jobs``, tables with options; ``preparing_sizes`` prepares tables of many rows or columns,
``pursuing`` measures the pursuit of sums with functions.
"""
