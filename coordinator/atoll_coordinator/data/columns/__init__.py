"""What the columns themselves say before anything is searched: checks, each a pure function, in one table.

- `finding`: `Finding`, a sentence with what to do, and what is done about it; `Columns`, what a check sees
- `examination`: `examine`: the table of checks, made in order, and what they found acted on where that is safe
- `fill_values`, `clipping`, `levels`, `counters`, `relations`, `maps`, `second_order`: the checks
- `sums`: sums in a fixed order, since what a check leaves out changes what the search sees

Cheap enough for a client: nothing is smoothed or compiled.
"""
