"""Analysis of models and the Python API: figures beside closed forms and the literature, and times.

``dynamics`` measures what `atoll.analysis` finds, ``branches`` what it follows along a parameter, ``programs`` how long
imports, calls and commands take and what they leave behind; ``check`` is one such figure.
"""
