"""Exports of the seven systems of Table III, opened by the programs that they are for.

`models` are the published equations as results; `readers` read text formats by little parsers of their own; `programs`
run what is installed. ``python -m benchmarks.exports`` prints a table.
"""
