"""What every user of a service stands on, be it the command line, Python or another program.

``client`` asks a coordinator over the bus, ``subscription`` hears of changes, ``follower`` follows a job to its end.
``options`` is the table of what a job may be told, ``configure`` makes a configuration of values for them.
``local_coordinator`` and ``local_workers`` are a service on this machine: router and coordinator in a thread, workers
in processes.
"""
