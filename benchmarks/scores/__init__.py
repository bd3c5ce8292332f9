"""Which score finds the law among systems near it? Several scores on the same pools of systems, table by table.

- ``pools``: a table of the corpus, its law, and systems that are longer, shorter or different in one place
- ``description``: scores by simulation of whole trajectories and pieces, the one in use among them
- ``filtering``: the likelihood of a Kalman filter with noise in the states and in the sensors, by ``kernels``
- ``evidence``: what constants cost, whatever they are written with
- ``outcomes``: what is chosen, and tables of it
"""
