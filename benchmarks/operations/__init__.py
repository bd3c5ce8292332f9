"""How the service behaves: time, memory, faults, many workers.

``scaling`` and ``scale`` (``simulated_islands``, ``island_samples``) measure workers and the coordinator, ``big_data``
memory, ``faults`` (``strikes``) real faults; ``digests``, ``side_by_side`` and ``same_results`` (``small_jobs``,
``differences``) whether results are equal, ``pipelines`` draws tables with options, ``fuzz`` hostile messages.
"""
