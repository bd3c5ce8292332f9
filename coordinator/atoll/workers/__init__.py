"""Island workers on an existing Dask or Ray cluster, by one call: `start_on`.

``start`` checks the arguments and has the worker program of one machine, and the handle that the caller gets.
``dask_cluster`` and ``ray_cluster`` make the machines of a cluster start and end the program. Importing this package
needs neither Dask nor Ray. Only names of installed classes, strings and numbers are sent to a cluster.
"""

from atoll.workers.start import Handle, start_on

__all__ = ["Handle", "start_on"]
