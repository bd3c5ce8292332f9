"""Code shared by coordinator and island worker; it imports no other package of Atoll.

``config``, ``data`` and ``expression`` define a job; ``search`` holds the rules that both sides must apply alike
(fronts, random streams, the commit order); ``wire`` the messages and the bus, ``task_frames`` the messages between a
worker and its task process; ``compilation`` the kernels' compiler; ``machine`` cores, memory and folders of this
machine; ``main_program``, ``command_line``, ``signals``, ``logs``, ``quoting``, ``redaction`` and ``errors`` the parts
that both command lines share.
"""

VERSION = "0.1.0"
"""Version of the distribution; kept equal to pyproject.toml by a test."""

PROTOCOL_VERSION = 14
"""Raised whenever a message on the wire changes its shape or meaning."""

ENGINE_REVISION = 13
"""Raised whenever the same seed may give other bits: a change of kernels, of variation or of seeding."""
