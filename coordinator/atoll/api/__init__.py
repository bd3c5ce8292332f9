"""Atoll as a Python library: a client of the same service as the command line, local or on another machine.

``discover`` has the functions `discover` and `submit`, and the local service that they start (its program is ``host``);
``campaign`` has `discover_many`;
``discoverer`` has a class with PySINDy's conventions, ``regressor`` one with scikit-learn's; ``tables`` turns arrays
and frames into tables, and options in messages into Python arguments; ``model`` has `atoll.Model`. The path of a call:

`discover.discover` -> `discover.local_address` -> (process) `host.main` -> `atoll.client`; then `client.Client`.
"""
