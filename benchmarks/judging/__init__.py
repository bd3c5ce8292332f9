"""Is what was found right? Needs the truth, and nothing of a search.

``rules`` has the answer of every rule by which an equation has the true form or not: ``forms`` decides by a fit whether
it is exact in form, or has the truth's form however its constants are. ``errors`` measures how far it is from the
truth, ``coverage`` judges the intervals of an equation, ``generalisation`` its predictions from fresh initial
conditions.
"""
