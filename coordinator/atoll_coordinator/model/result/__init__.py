"""Builds the result of a job. The classes that a result consists of are in `atoll_coordinator.result`.

- `building`: `build_result` builds the whole result and turns programs into text
- `tables`: the parts of a result about the data
- `shared_terms`: terms that several equations have in common
- `known_equations`: the errors of equations that the user gave, and warnings about them
"""
