"""Checks of columns before anything is searched, cheap enough for a client: nothing is smoothed or compiled.

- `finding`: `Finding`, a sentence with advice; `ExaminedColumns`, the input of a check; sums in a fixed order, since a
  column that is left out changes the data of the search
- `values`, `motion`: the checks
- `examination`: `examine`: runs all checks in order and acts on their findings where that is safe
"""
