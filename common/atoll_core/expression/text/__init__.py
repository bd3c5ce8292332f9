"""Programs as text: `infix` writes it, `parsing` reads it back to the bit, `export` makes LaTeX, MathML and sympy."""
