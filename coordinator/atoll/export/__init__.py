"""Export a model in the formats of other programs.

`formats` has the table of formats, and writes LaTeX, SymPy and CSV. `description` collects the content of an export,
independent of the language. `language` writes this content with the notation, names and templates of one of the
`languages`. `sbml` writes XML, and `petab` writes a folder.
"""
