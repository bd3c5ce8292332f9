"""What the columns of a table mean, from their names and the options alone.

- `column_options`: which columns the options name, units taken off names, contradictions refused
- `time_column`, `trajectory_column`: which column is which where the options do not say
- `roles`: `assign_roles`: which column is time, trajectory, state, input, target, derivative or weight
- `symbols`: `assign_symbols`: the name of each variable in expressions
- `unit_texts`: which texts of a header are units
- `left_hand_sides`: from a left-hand side as a user writes it to the variable it belongs to

Names and options go in, `Roles` and symbols come out; no value of the table is looked at.
"""
