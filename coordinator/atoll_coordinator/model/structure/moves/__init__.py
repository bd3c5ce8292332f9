"""Structural moves: simplified programs that differ from a program at a single node. Each structure occurs once.

`replacement` replaces a node by an expression; the other modules use it. `reductions` remove parts, `neighbours`
exchange a part, and `extensions` add a small part, or larger parts (leaps). All results are written as sums of
products. Their constants are not fitted yet.
"""
