"""Identifiability of a model's constants, and the experiments that would decide between models.

``fits`` lays out the trajectories of a result, or of data files, and fits its equations again; ``identifiability`` has
profile likelihoods; ``alternatives`` are other systems fitted to the same data, ``designs`` possible experiments and
their expected outcomes, ``suggestion`` the best experiments; ``comparison`` compares two models.

Everything is a pure function of a result, the data and a seed.
"""
