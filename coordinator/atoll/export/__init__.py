"""A model in the formats of other programs.

`formats` is the table of them. `description` is a model as it is written down, in no language yet; `language` writes it
by the words and the `template` of one, with names that `naming` finds. The languages: `python`, `c`, `julia`, `matlab`,
`modelica`, `xppaut` and `sbml`. `petab` writes a folder, `text` what people and sympy read.
"""
