"""A model in the formats of other programs.

`formats` is the table of formats, and writes what people and sympy read. `description` is the content of an export,
before any language; `language` writes it with the notation, the names and the templates of one of `languages`. `sbml`
writes XML, `petab` a folder.
"""
