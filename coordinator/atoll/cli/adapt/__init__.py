"""``coordinator adapt``: as many jobs of a batch system with workers as the coordinator's queue has work for.

`adapt_policy` decides, `batch` submits, lists and ends jobs by the templates of `batch_systems`, `adapt` looks at both
sides again and again.
"""
