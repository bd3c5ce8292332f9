"""Programs as text: `infix` writes programs as text, and `parsing` reads this text; the result has the same bits.
`export` writes LaTeX and MathML, and makes sympy objects."""
