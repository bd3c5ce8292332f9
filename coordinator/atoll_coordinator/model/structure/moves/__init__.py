"""Structural moves: programs made of one program by a change at a single node, simplified, each structure once.

`replacement` puts an expression in the place of a node, and is what the others are made of; `reductions` leave parts
out, `neighbours` exchange one, `extensions` add a small part or, as leaps, larger ones. The constants of what they
yield wait for a fit.
"""
