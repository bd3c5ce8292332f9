"""Code shared by coordinator and island worker; it imports no other package of Atoll.

- ``config``, ``data`` and ``expression`` define a job.
- ``search`` holds the rules that both sides must apply in the same way: fronts, random streams, the commit order.
- ``wire`` has the messages and the bus; ``task_frames`` the messages between a worker and its task process.
- ``compilation`` compiles kernels. ``machine`` finds the cores, memory and folders of this machine.
- ``main_program``, ``command_line``, ``signals``, ``logs``, ``quoting``, ``redaction`` and ``errors`` are used by both
  command lines.
"""

VERSION = "0.1.0"
"""Version of the distribution; kept equal to pyproject.toml by a test."""

PROTOCOL_VERSION = 14
"""Raised whenever a message on the wire changes its shape or meaning."""

ENGINE_REVISION = 13
"""Raised whenever the same seed may give other bits, after a change of kernels, of variation or of seeding."""
