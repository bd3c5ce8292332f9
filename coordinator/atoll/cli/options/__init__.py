"""From words to options.

``parser`` makes the parser of all commands from ``arguments``, a table of verbs, and the options of a job in
`atoll.client.options`: of the standard library only. ``values`` reads what argparse leaves as text. What both programs
share is in `atoll_core.command_line`.
"""
