"""A model in the formats of other programs.

`formats` is the table of them. `describing` makes a `description` of a model, which is in no language yet; `language`
writes it by the words and the `template` of one, with names that `naming` finds. The languages: `python`, `c` (both
with `integrators` of their own), `julia`, `matlab`, `modelica`, `xppaut` and `sbml` (units: `sbml_units`). `petab`
writes a folder, `text` what people and sympy read.
"""
