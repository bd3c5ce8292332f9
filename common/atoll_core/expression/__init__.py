"""Expressions as programs: the search makes them, the coordinator refines them, and both print them.

- `operators`: the table of operators. `program`: an expression as a list of nodes, its bytes, and a builder.
- `text` reads and prints programs. `writing` finds the shortest form of a function.
- `simplification` makes a program canonical without changing a bit of its values.
- `evaluation` computes values and derivatives after the search, by numpy or as Python functions; `kernels` compute them
  during the search, as machine code.
- `derivative` makes programs of derivatives.
- `restrictions` are users' conditions on an equation. `unit_coefficients` makes coefficients equal to 1 explicit.
- `operation_list` arranges a program as a list that the search evolves.
"""
