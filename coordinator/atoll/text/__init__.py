"""A result as text for people.

`render` writes the whole text, `tables` its tables, `process` the part on a stochastic process, `conclusion` a summary
in plain words.
"""
