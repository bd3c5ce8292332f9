"""Compiled parts of a trajectory fit, from the inside out.

`rates` evaluates a system and its slopes at a point; `integrate` carries states and sensitivities along segments by
explicit steps, `implicit` by implicit ones; `innovations` makes errors independent; `normal_equations` sums up what a
step of the fit needs and solves for it.
"""
