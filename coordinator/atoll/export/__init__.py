"""A model in the formats of other programs: one writer for each.

`formats` is the table of them, `methods` what a model has; `content` is what all formats hold, and a `Wording` of it in
one language; `naming` finds names that a language takes. `python`, `c`, `julia`, `matlab`, `modelica`, `xppaut` and
`sbml` (units: `sbml_units`) write one text each, `petab` a folder, `text` what people and sympy read. How languages
write expressions stands in `atoll_core.expression.text.notation`.
"""
