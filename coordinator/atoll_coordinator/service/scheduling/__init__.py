"""Who is served next, and how much of everything each may have. Pure; seconds come in.

``fair_share`` says in which order users' jobs are served: deficit round robin between users, priority and age within
one user's. ``job_queue`` has the jobs that wait and those that are under way, and decides which are taken up, held and
released; ``task_turns`` says whose tasks go to workers next; ``limits`` is how much is allowed, ``task_time`` what of
it is used up.

Submission -> `job_queue.JobQueue.add` -> `JobQueue.decide` (`fair_share.FairShare.order`) -> what the controller does.
"""
