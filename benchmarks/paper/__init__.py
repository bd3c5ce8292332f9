"""The figures of Schmidt and Lipson (2008), computed again.

``table1`` (``published``, ``archipelago``: islands in this process) and ``table3``.
"""
