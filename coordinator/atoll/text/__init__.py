"""A result as text for people.

`render` has the whole, `tables` its tables, `process` what is said of a process, `conclusion` what it comes to in plain
words.
"""
