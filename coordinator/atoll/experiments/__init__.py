"""Identifiability of a model's constants, states and forecasts, and the experiments that would decide between models.

``fits`` reads the trajectories of a result, or of data files, and fits the equations again. ``identifiability``
computes profile likelihoods. ``alternatives`` fits other systems to the same data. ``designs`` predicts the outcomes of
possible experiments, and ``suggestion`` chooses the best experiments. ``comparison`` compares two models. ``states``
fits the initial states of a known law, and ``smoothing`` estimates states along trajectories. ``draws`` draws
constants, and ``forecast`` simulates them after the last row.

All functions are pure: they depend only on a result, the data and a seed.
"""
