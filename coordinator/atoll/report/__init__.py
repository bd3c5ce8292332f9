"""A result as one HTML page that needs neither network nor script.

``page`` puts the sections together: ``equations`` has the sections on equations, constants, candidates and searches,
``trajectories`` those on measurements, simulations, processes and dynamics. ``findings`` is the content of a page,
``markup`` builds elements, in which every text is escaped, and draws charts as SVG.
"""
