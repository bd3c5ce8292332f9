"""Stochastic processes: are drift and diffusion found in form, and do the intervals of their constants hold?

``processes`` are the processes of the benchmark, one of them also with errors of measurement, two with a state without
noise of its own; ``judging`` compares what was found with the truth; ``__main__`` runs all of it, through the service
or without a search.
"""
