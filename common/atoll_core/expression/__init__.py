"""Expressions as programs: the search makes them, the coordinator refines them, and both print them.

`operators` is the one table of operators, `program` an expression as a list of nodes, in memory and as bytes, and the
builder of programs. `text` reads and prints programs; `simplification` makes them canonical with every bit of their
values kept; `writing` finds the shortest writing of a function. `evaluation` gives values and derivatives by
numpy and as Python functions, after the search; `kernels` the same, compiled, during the search. `derivative` makes
programs of derivatives. `restrictions` are users' conditions on an equation, `unit_coefficients` makes coefficients
of one explicit, and `operation_list` arranges a program as a list that the search evolves.
"""
