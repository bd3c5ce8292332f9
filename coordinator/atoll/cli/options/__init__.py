"""From words to options.

``parser`` builds the argument parser of all commands, those of a job from their table in `atoll.client.options`;
``service`` the part for ``serve``, ``router`` and ``doctor``. Both import the standard library only. ``job_id`` checks
ids, ``values`` reads numbers and intervals of other verbs. What both programs share is in `atoll_core.command_line`.
"""
