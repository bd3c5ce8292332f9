"""A model as people see it: ``notation`` writes it as text, LaTeX, MathML and HTML, ``plots`` draws it.

``series`` and ``curves`` are the numbers of its pictures, which a report and a page draw as well.
"""
