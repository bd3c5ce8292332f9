"""Expressions as programs: the search finds programs, the coordinator refines programs, and both print programs.

- `operators`: the table of operators. `program`: an expression as a list of nodes, the bytes of a program, and a
  builder of programs.
- `text` reads and prints programs. `writing` finds the shortest form of a function.
- `simplification` makes a program canonical without changing a bit of its values.
- `evaluation` computes values and derivatives after the search, by numpy or as Python functions; `kernels` compute them
  during the search, as machine code.
- `derivative` makes programs of derivatives.
- `restrictions` are users' conditions on an equation. `unit_coefficients` writes out coefficients that are equal to 1.
- `operation_list` arranges a program as a list that the search evolves.
"""
