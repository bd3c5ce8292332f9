"""What coordinator and island worker share.

``config``, ``data`` and ``expression`` say what a job is; ``search`` holds the rules that both sides must apply alike
(fronts, random streams, the commit order); ``wire`` the messages and the bus; ``compilation`` the kernels' compiler;
``machine`` what this process may use of its machine; ``main_program``, ``command_line``, ``hints``, ``logs``,
``redaction`` and ``errors`` what both command lines share.

It imports no other package of Atoll.
"""

VERSION = "0.1.0"
"""Version of the distribution; kept equal to pyproject.toml by a test."""

PROTOCOL_VERSION = 13
"""Raised whenever a message on the wire changes its shape or meaning."""

ENGINE_REVISION = 12
"""Raised whenever the same seed may give other bits: a change of kernels, of variation or of seeding."""
