"""Programs as text: `parsing` reads what `infix` writes, to the bit, and what people write.

`form` is what all writings of a program share, `infix` has the notations of other languages as well, `export` makes
LaTeX, MathML and sympy objects.
"""
