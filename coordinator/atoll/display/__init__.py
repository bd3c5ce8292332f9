"""Display a model: ``notation`` writes it as text, LaTeX, MathML and HTML, ``plots`` draws it with Matplotlib.

``curves`` computes the numbers of the pictures for reports, pages and notebooks.
"""
