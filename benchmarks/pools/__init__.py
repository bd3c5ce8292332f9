"""Stored pools of searches, refined and judged again: they show the effect of a change of refining in minutes.

`stored` keeps the outcome of a search in files of JSON, `cases` generates their tables and judges results, `outcomes`
compares the equations found with the reference; ``make judge`` runs all of it.
"""
