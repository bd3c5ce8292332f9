"""The roles of the columns of a table, from their names and the options alone: no value is looked at, but for one hint.

`columns`: names, units and options; `roles`: `assign_roles` and `assign_symbols`.
"""
