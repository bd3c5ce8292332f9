"""Systems of many states: yeast glycolysis, Lorenz 96 with up to 100 states, networks, a chain of pendulums.

- `systems`: their equations, and runs from random initial conditions; flows of ``dysts`` from their files
- `campaign`: all searches that are asked for, one after another, each judged, and how each ended
- `laws`: the laws that regression alone finds, judged
- `preparing`: processor seconds of preparing, on simulated workers
"""
