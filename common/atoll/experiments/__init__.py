"""What is said of the data that a model needs: plain objects, made by `atoll_coordinator.experiments`.

``identifiability`` is what the data determine of each constant, ``suggestions`` the experiments that would tell most.
"""
