"""What every user of a service stands on, be it the command line, Python or another program.

``client`` asks a coordinator over the bus, ``follower`` follows a job to its end. ``local_coordinator`` and
``local_workers`` are a service on this machine: router and coordinator in a thread, workers in processes.
"""
