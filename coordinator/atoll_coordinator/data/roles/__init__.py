"""The roles of the columns of a table, by their names and the options; values are used only for a hint in one message.

`names_and_options`: units in names, columns that options name, contradictions between options; `roles`: `assign_roles`
and `assign_symbols`.
"""
