"""The roles of the columns of a table, from names and options alone; values are used only for one hint.

`columns`: names, units and options; `roles`: `assign_roles` and `assign_symbols`.
"""
