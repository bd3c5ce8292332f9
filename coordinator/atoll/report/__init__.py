"""A result as one HTML page without scripts or external resources.

``page`` joins the sections. ``equations`` has the sections about equations, constants, candidates and searches;
``trajectories`` has the sections about measurements, simulations, processes and dynamics. ``findings`` computes the
content of a page. ``bands`` draws smoothed states and forecasts as SVG files. ``markup`` builds elements, which escape
every text, and draws charts as SVG.
"""
