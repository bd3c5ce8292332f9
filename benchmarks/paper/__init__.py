"""The figures of Schmidt and Lipson (2008), computed again.

``table1`` (``published``), ``table3`` and ``seven`` (whole systems), ``figure1`` (``figure1_runs``, ``random_targets``,
``population``); ``readings`` (``readings_runs``) what the paper leaves open; ``guesses`` measures what guesses save;
``archipelago`` runs islands in this process.
"""
