"""What every benchmark needs.

``systems`` samples the systems that are searched; ``service`` starts a coordinator and workers and gives them jobs;
``parallel`` runs many tasks in processes; ``command_line`` has the options that several benchmarks share; ``record``
writes figures to a JSON file with the machine and its load; ``journal`` keeps searches, to go on with;
``report`` presents verdicts; ``stopwatch`` times a job.
"""
