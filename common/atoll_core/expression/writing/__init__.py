"""The shortest writing (see the glossary) of a function under the rules of real algebra.

- `sums_of_products`: a normal form: the order, signs and phases are fixed, sums are not nested, and like terms are
  joined
- `identities`: sums that equal a given sum, by one identity
- `layout`: a sum written as an expression, and the cost of the expression
- `shortest`: the search for the shortest writing, checked over the range of the data
- `expansion`: an equation as a sum of terms in which each constant has a separate meaning
"""
