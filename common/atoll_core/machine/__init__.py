"""What this process may use of its machine, and what it takes of it.

- ``cores``: how many cores it may use: affinity, the control group's quota, Slurm's allocation.
- ``usage``: memory and processor time taken so far, as heartbeats and logs show them.
- ``garbage``: how often Python looks for garbage, set once when a program starts.

Nothing here knows anything else of `atoll`.
"""
