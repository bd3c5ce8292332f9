"""Programs as text: `parsing` reads what `infix` writes, to the bit, and what people write.

`export` makes LaTeX and sympy objects.
"""
