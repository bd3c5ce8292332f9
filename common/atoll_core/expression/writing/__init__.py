"""The shortest writing of a function, as real algebra allows.

- `sums_of_products`: expressions in which order, brackets of sums, like terms, signs and phases have one form each
- `failures`: what becomes of a mistake in rewriting
- `identities`: sums that equal a given one, one step away
- `layout`: a sum written as an expression, and what the writing costs
- `shortest`: the search for the shortest writing, also checked over the box of the data; programs in, programs out
"""
