"""Is what was found right? Needs the truth, and nothing of a search.

``rules`` has the answer of every rule by which an equation has the true form or not: ``forms`` decides by a fit whether
it is exact in form, or has the truth's form however its constants are. ``errors`` measures how far it is from the
truth; ``verdict`` judges an equation of a result, ``coverage`` its intervals, ``generalisation`` its predictions from
fresh initial conditions.
"""
