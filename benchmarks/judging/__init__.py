"""Is what was found right? Needs the truth, and nothing of a search.

``forms`` decides whether a model is exact in form (``rewriting`` and ``angles`` bring it to ``fractions`` first);
``verdict`` judges an equation of a result, ``coverage`` its intervals, ``generalisation`` its predictions from fresh
initial conditions; ``equivalents`` are other ways to write known truths;
``writings`` counts how short the equations are that are shown.
"""
