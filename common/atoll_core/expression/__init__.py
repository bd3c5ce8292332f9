"""Mathematical expressions as programs: what the search makes, the coordinator refines, and both print.

`operators` is the one table of operators; `program` an expression as a list of nodes, in memory and as bytes. Programs
are made by a `builder`, by `text.parsing` from text, and by `simplification` from other programs, every bit of their
values kept; `writing` finds the shortest writing of a function;
`unit_coefficients` makes factors of one constants. `operation_list` arranges a program as the lists that
the search evolves. `evaluation` gives values and derivatives by numpy, for what comes after the search; `kernels` the
same, compiled, for the search. `derivative` makes programs of derivatives, `compiled` one function of several programs.
`text` turns programs into infix text, LaTeX and sympy objects.
"""
