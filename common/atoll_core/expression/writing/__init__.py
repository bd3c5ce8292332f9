"""The shortest writing of a function, as real algebra allows.

- `sums_of_products`: a normal form in which order, nested sums, like terms, signs and phases are settled
- `identities`: sums that equal a given one, one step away
- `layout`: a sum written as an expression, and the cost of the writing
- `shortest`: the search for the shortest writing, checked over the range of the data
- `expansion`: an equation as a sum of terms in which each constant has a separate meaning
"""
