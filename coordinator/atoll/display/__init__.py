"""A model as people see it: ``notation`` writes it as text, LaTeX, MathML and HTML, ``plots`` draws it."""
