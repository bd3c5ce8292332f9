"""A model as people see it: ``notation`` writes it as text, LaTeX, MathML and HTML, ``plots`` draws it.

``series`` are the numbers of its pictures, which a report draws as well.
"""
