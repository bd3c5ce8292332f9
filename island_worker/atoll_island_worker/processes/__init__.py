"""The processes of several workers on one machine.

``fork_server`` loads libraries and kernels once and forks workers; ``supervisor`` starts them again when they die,
prints why, passes SIGTERM on, and kills those that do not end.
"""
