"""Compiled evaluation of programs over many rows, with the same bits on every machine.

From the inside out: `elementary` are sine, logarithm and so on for one number; `lanes` the arithmetic of a block of 16
rows; `functions` the elementary functions over such a block; `tape` values and gradients of whole programs.
"""
