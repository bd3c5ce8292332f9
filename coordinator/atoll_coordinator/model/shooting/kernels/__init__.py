"""Compiled parts of a trajectory fit, from the inside out.

`rates` evaluates the rates of a system and their derivatives at a point. `integrate` integrates states and
sensitivities along segments by explicit steps, `implicit` by implicit steps. `innovations` transforms correlated errors
into independent ones. `normal_equations` sums up the normal equations of a step of the fit and solves them.
"""
