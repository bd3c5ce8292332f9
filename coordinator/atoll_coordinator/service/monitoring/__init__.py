"""What clients and operators see. Nothing here decides anything.

`event_log` records events of jobs and workers, and log lines of workers; `breakages` counts errors of this program;
`job_views` has views and counters of jobs, and what results are composed of; `followers` notifies clients of changes;
`metrics` are for Prometheus.
"""
