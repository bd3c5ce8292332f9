"""Programs as algebra: equal programs, programs one step away, sums of terms. No data, no fits.

- `moves`: programs one structural move away: reductions, neighbours, extensions
- `constant_units`: units of constants, and terms that cannot be right
- `poles`: where a program has no finite value among given points

Programs go in, programs come out.
"""
