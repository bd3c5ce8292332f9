"""Programs that measure: every figure of RESULTS.md comes from one of them, or one that it says was removed.

``harness`` is what all of them share; ``analysis``, ``paper``, ``peers``, ``noise``, ``corpus``, ``dysts``,
``stochastic``, ``many``, ``real``, ``first_hour``, ``kernels`` and ``operations`` each measure one thing; ``judging``
decides whether an equation is right.
"""
