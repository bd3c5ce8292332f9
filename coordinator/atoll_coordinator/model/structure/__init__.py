"""Programs as algebra: what is the same, what lies one step beside, what is made of terms. No data, no fits.

- `moves`: programs one structural move away: reductions, neighbours, extensions
- `one_sided`: intervals of constants that lie on a bound
- `constant_units`: units of constants, and terms that cannot be right
- `poles`: where a program has no finite value among given points

Programs go in, programs come out.
"""
