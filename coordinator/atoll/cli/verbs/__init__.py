"""The functions of the verbs: each takes the parsed options and returns the exit code.

``run`` searches on this machine, ``submit`` on a coordinator. ``serve`` has the services, ``web`` the
page. ``jobs`` asks a coordinator about jobs and workers, ``results`` analyses and exports results, ``texts`` prints
schemas and shell completion. `atoll.cli.parser.VERBS` maps verbs to modules.
"""
