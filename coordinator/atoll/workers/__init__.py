"""Island workers on a cluster that runs already, Dask's or Ray's, by one call: `start_on`.

``start`` finds out what cluster it is given, ``program`` is the worker program on one machine of it, ``handle`` what
the caller gets; ``dask_cluster`` and ``ray_cluster`` have a cluster's machines start the program and end it. Neither is
needed to import this, and nothing is sent to a cluster but names of what is installed there, strings and numbers.
"""

from atoll.workers.start import Handle, start_on

__all__ = ["Handle", "start_on"]
