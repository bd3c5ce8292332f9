"""Clients of a service: used by the command line, by Python and by other programs.

``client`` sends requests to a coordinator over the bus, ``follower`` subscribes to changes and follows a job to its
end. ``job_options`` is the table of a job's options, ``configure`` builds a configuration from their values.
``over_http`` replaces the bus by HTTP requests, ``local_processes`` starts the processes of a search on this machine.
"""
