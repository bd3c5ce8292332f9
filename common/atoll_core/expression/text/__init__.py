"""Programs as text: `parsing` reads what `infix` writes, to the bit, and what people write.

`form` is what all writings of a program share, `notation` how other languages write expressions, `export` makes LaTeX,
MathML and sympy objects.
"""
