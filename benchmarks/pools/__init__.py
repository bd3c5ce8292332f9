"""Stored pools of searches, refined and judged again: what a change of refining gains and loses, in minutes.

`stored` keeps what a search hands on in files of JSON, `cases` draws the tables of these and judges results, `outcomes`
compares what was found with the reference; ``make judge`` runs all of it.
"""
