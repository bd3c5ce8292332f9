"""Information for clients and operators. No decisions are made here.

`event_log` records events of jobs and workers, and log lines of workers; `breakages` counts internal errors;
`job_views` has views and counters of jobs, and drafts of results; `followers` notifies clients of changes; `metrics`
has metrics for Prometheus.
"""
