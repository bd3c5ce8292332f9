"""Stochastic processes: are drift and diffusion found in form, and do the intervals of their constants hold?

``processes`` are the processes of the benchmark, one of them also with errors of measurement, two with a state without
noise of its own; ``judging`` compares what was found with the truth; ``peers`` treats the same paths by Kramers-Moyal
averaging and stochastic SINDy, in an environment of its own; ``__main__`` runs all of it, through the service or
without a search. ``covariance`` measures how often a covariance of noises is sought, ``intervals`` how often those of
the true equations' constants hold, ``proposals`` how often a job
without ``--stochastic`` proposes it.
"""
