"""A result as text.

`render` writes the whole text with its tables. `conclusion` writes a summary in plain words.
"""
