"""Stochastic processes: are drift and diffusion found in form, and do the intervals of their constants hold?

``processes`` are the six processes of the benchmark, one of them also with errors of measurement; ``judging`` compares
what was found with the truth; ``averaging`` estimates the same functions by Kramers-Moyal averaging with the package
``kramersmoyal``, in an environment of its own; ``__main__`` runs all of it through the service.
"""
