"""``coordinator doctor``: is everything as it should be, and if not, what is to be done?

``doctor`` runs all checks and prints their findings; ``machine`` looks at this machine, ``network`` at ports,
certificates, the coordinator and its workers. A check yields `finding.Finding`.
"""
