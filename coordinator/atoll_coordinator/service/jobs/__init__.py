"""One job. Pure.

`job` has the states of a job from submission to end, its archipelagos, and the actions that the controller carries out.
`checks` has the sentences on why a job cannot be searched.

Stored record or submission -> `job.Job` -> (prepared data) `Job.start` -> (reports) `Job.add_report` -> actions.
"""
