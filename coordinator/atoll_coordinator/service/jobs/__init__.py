"""One job. Pure.

``job`` has the states of a job from submission to end, its archipelagos, and the actions that follow from what happens;
the controller carries them out. ``defaults`` fills in settings that
depend on the data, ``checks`` gives reasons for which a job cannot be searched, ``time_limit`` says when `--max-time`
ends what a job does.

Record of the store or submission -> `job.Job` -> (prepared data) `Job.start` -> (reports) `Job.add_report` -> actions.
"""
