"""A model in a user's hands, after it was found.

``model`` has the class `atoll.Model`, read from ``result.json``; ``vector_field`` the right-hand sides as functions of
numbers, with their derivatives; ``parameters`` the constants and their joint errors; ``arguments`` reads what users
give as numbers; ``start`` reads where a simulation starts and what drives it; ``simulation`` integrates from
any initial state, within bounds; ``ensembles`` draws paths of a stochastic process; ``display`` writes a model as text,
LaTeX, MathML and HTML; ``plots`` draws it; ``export`` writes it for other programs.
"""
