"""From measurements of a stochastic process to what its drift and its diffusion are sought by.

- `steps`: `Measurements` -> `Steps`: what the states move from row to row
- `bins`: rows that are near each other, by a k-d tree
- `moments`: mean and products of steps in each bin; measurement noise and correlations between states told by tests
- `targets`: all of these -> `Preparation`: one target for each drift and for each component of the diffusion

What goes into the search is made with + - * / and square roots alone, sums exactly rounded.
"""
