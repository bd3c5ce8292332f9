"""Atoll as a Python library: a client of the same service as the command line, started here or found elsewhere.

``discover`` has `discover` and `submit`; ``discoverer`` a class with PySINDy's conventions and ``regressor`` one by
scikit-learn's rules; ``tables`` makes tables of arrays and frames; ``wording`` says errors in the words of Python;
``notebook_progress`` shows progress in a notebook; ``session`` is the service that this interpreter has started, by the
command in ``host``, and keeps.

`discover.discover` -> `session.local_address` -> (process) `host.main` -> `atoll.client`; then `client.Client`.
"""
