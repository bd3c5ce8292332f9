"""Compiled loops over the rows of one signal: `loess` smooths and bins rows, `stencils` interpolates."""
