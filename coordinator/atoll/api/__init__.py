"""Atoll as a Python library: a client of the same service as the command line, started here or running elsewhere.

``discover`` has `discover`, `submit` and the local service that they start and keep (its program is ``host``);
``discoverer`` has a class with PySINDy's conventions, ``regressor`` one with scikit-learn's; ``tables`` turns arrays
and frames into tables, and names options in messages as arguments; ``model`` has `atoll.Model`.

`discover.discover` -> `discover.local_address` -> (process) `host.main` -> `atoll.client`; then `client.Client`.
"""
