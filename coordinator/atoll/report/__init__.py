"""A result as one HTML page that needs neither network nor script.

``page`` puts the sections together; ``markup`` builds elements, in which every text is escaped; ``chart`` draws
pictures as SVG; ``page.css`` and ``pictures.css`` are their styles. ``findings`` is what a page is about.

A section is a module: ``overview`` what was asked and found, ``fit`` measured beside simulated or fitted values,
``choice`` fronts and candidates, ``constants``, ``dynamics`` the phase plane and what moves in it, ``process``
ensembles of stochastic processes, ``search`` how the islands converged, ``origin`` how to repeat the run.
"""
