"""A trial of ``dask.distributed`` as what carries Atoll's tasks to workers (ADR 0074).

``tasks`` are real pieces of Atoll's work as functions of plain inputs, ``cluster`` the programs of a Dask cluster on
this machine, ``relay`` reads along what a client sends, ``measures`` what is measured. ``python -m
benchmarks.dask_trial`` runs all.
"""
