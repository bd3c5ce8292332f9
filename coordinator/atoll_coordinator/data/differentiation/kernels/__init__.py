"""Compiled loops over the rows of one signal: `loess` smooths and thins, `stencils` interpolates. Arrays in and out."""
