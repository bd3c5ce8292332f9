"""Programs as algebra: what is the same, what lies one step beside, what is made of terms. No data, no fits.

- `moves`: programs one structural move away: reductions, neighbours, extensions
- `term_libraries`: sums of products, waves and quotients of the variables
- `one_sided`: intervals of constants that lie on a bound
- `constant_units`: those of constants, and terms that cannot be right
- `poles`: where a program has no finite value among given points

Programs go in, programs come out.
"""
