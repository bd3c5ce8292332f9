"""What every benchmark needs.

``systems`` samples the systems that are searched, ``solving`` solves equations; ``jobs`` configures searches and makes
tables of columns; ``service`` starts a coordinator and workers and gives them jobs; ``campaign`` works off a list of
searches; ``parallel`` runs many tasks in processes; ``command_line`` has the options that several benchmarks share;
``record`` writes figures to a JSON file with the machine and its load; ``journal`` keeps searches, to go on with;
``tables`` present them; ``stopwatch`` times a job, and ``accounts`` has what one process took.
"""
