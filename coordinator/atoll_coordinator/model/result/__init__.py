"""The result of a job is made here; what it consists of is in `atoll_coordinator.result`.

`result` has the whole, and turns programs into text; `tables` says what a result has of the data, `shared_terms` what
equations have in common, `known` how given equations do on the data.
"""
