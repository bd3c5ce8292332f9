"""Structural moves: programs that differ from a program at a single node, simplified, each structure once.

`replacement` puts an expression in the place of a node, and the other moves use it; `reductions` leave parts
out, `neighbours` exchange one, `extensions` add a small part or, as leaps, larger ones. The constants of the
results are not fitted yet.
"""
