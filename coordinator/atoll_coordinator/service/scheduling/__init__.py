"""Which job is started next, and the limits of each user. Pure, except for reading a file of limits.

`fair_share` orders users by deficit round robin, and the jobs of one user by priority and age; `job_queue` decides
which jobs are started, held and released; `limits` has limits and used task time.

Submission -> `JobQueue.add` -> `JobQueue.decide` (`FairShare.order`) -> the controller acts.
"""
