"""What the data leave open in a model, and which experiment would settle it.

- `measured`: the trajectories of a result, or of data files, laid out for fits
- `systems`: the equations of a result as systems that can be fitted, and other equations beside them
- `profiles`: profile likelihoods of constants
- `relations`: directions in which constants can change together, and what of them is determined, in words
- `identifiability`: both together, for all constants of a model
- `rivals`: candidate systems fitted to the same data, with weights, and what they foretell of an experiment
- `designs`: possible experiments and what is expected of each
- `space`: which experiments can be made: bounds, lengths, costs
- `design_search`: `suggest`: the experiments that are worth most, ranked
- `determination`, `suggestion`: what both say, as values

A result goes in; everything is a pure function of it, of the data and of a seed.
"""
