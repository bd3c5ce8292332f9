"""From measurements of a stochastic process to what its drift and its diffusion are sought by.

- `steps`: `Measurements` -> `Steps`: what the states move from row to row; high differences along paths, which smooth
  motion leaves next to nothing of
- `bins`: rows that are near each other, by a k-d tree, and sums that are the same on every machine
- `roughness`: whether a state has noise of its own, follows states that have, or is smooth
- `correlations`: whether the noises of two states go together, by a test on signs
- `moments`: mean and products of steps in each bin; measurement noise told by a test
- `targets`: all of these -> `Preparation`: one target for each drift and for each component of the diffusion

What goes into the search is made with + - * / and square roots alone, sums exactly rounded.
"""
