"""From words to options, and from options to the configuration of a job.

``parser`` builds the argument parser of all commands, ``service`` the part for ``serve``, ``router`` and ``doctor``;
both import the standard library only. ``job_config`` overlays preset, job file and options to a `JobConfig`,
``prior_knowledge`` reads ``--guess``, ``--known``, ``--allow`` and ``--operators``, ``names`` ids and lists of names.
What both programs share is in `atoll_core.command_line`.
"""
