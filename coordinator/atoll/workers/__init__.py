"""Starts island workers on an existing Dask or Ray cluster by one call: `start_on`.

``start`` checks the arguments, and has the worker program of one machine and the handle for the caller.
``dask_cluster`` and ``ray_cluster`` start and end the program on the machines of a cluster. This package can be
imported without Dask and Ray. Only names of installed classes, strings and numbers are sent to a cluster.
"""

from atoll.workers.start import Handle, start_on

__all__ = ["Handle", "start_on"]
