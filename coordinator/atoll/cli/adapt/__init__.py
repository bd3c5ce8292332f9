"""``coordinator adapt``: as many jobs of a batch system with workers as the coordinator's queue has work for.

`adapt_policy` decides, `slurm` submits, lists and ends jobs of Slurm, `adapt` looks at both sides again and again.
"""
