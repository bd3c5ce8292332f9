"""Programs as text: `parsing` reads what `infix` writes, to the bit, and what people write.

`notation` is how other languages write expressions, `export` makes LaTeX and sympy objects.
"""
