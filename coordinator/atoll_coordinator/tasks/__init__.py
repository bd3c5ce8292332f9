"""The tasks of a search, functions from bytes to bytes: ``preparing`` a table and ``refining`` a job.

`atoll.tasks` runs them. ``defaults`` fills in the fields of a configuration that depend on the data.
"""
