"""Compiled evaluation of programs over many rows, with the same bits on every machine.

From the inside out: `elementary` has sine, logarithm and similar functions of one number. `lanes` has the arithmetic of
a block of 16 rows. `functions` applies the elementary functions to such a block. `tape` computes values and gradients
of whole programs.
"""
