"""A model as people see it: ``notation`` writes it as text, LaTeX, MathML and HTML, ``plots`` draws it with matplotlib.

``curves`` has the numbers of the pictures, for reports, pages and notebooks alike.
"""
