"""A model in the formats of other programs.

`formats` is the table of formats, and writes LaTeX, text and sympy. `description` is the content of an export,
independent of the language; `language` writes it with the notation, names and templates of one of `languages`. `sbml`
writes XML, `petab` a folder.
"""
