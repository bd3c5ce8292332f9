"""A model in a user's hands, after it was found.

``model`` has the class `atoll.Model`, made of a result; ``shortcuts`` its methods that other rooms have.
``equations``, ``parameters``, ``groups`` and ``candidates`` are what it consists of, ``vector_field`` its right-hand
sides as functions of numbers, with their derivatives, ``joint_errors`` the errors of all constants together.
``arguments`` reads what users give as numbers, ``files`` writes; ``beginnings`` and ``driving`` say where a
simulation begins and what drives it, ``start`` reads that from a file, ``simulation`` integrates, ``ensembles`` draws
paths of a stochastic process, ``scoring`` compares with data.
"""
