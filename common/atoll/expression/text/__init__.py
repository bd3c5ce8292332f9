"""Programs as text: `parsing` reads what `infix` writes, to the bit, and what people write.

`display` writes rounded, flattened expressions for the eye; `export` LaTeX and sympy objects.
"""
