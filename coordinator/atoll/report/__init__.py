"""A result as one HTML page without scripts or external resources.

``page`` puts the sections together: ``equations`` has the sections on equations, constants, candidates and searches,
``trajectories`` the sections on measurements, simulations, processes and dynamics. ``findings`` is the content of a
page, ``markup`` builds elements, in which every text is escaped, and draws charts as SVG.
"""
