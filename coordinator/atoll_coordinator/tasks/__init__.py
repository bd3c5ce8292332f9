"""The tasks of a search, from bytes to bytes: ``preparing`` a table and ``refining`` a job.

`atoll.tasks` runs them; ``defaults`` fills in what a configuration leaves open until the data are known.
"""
