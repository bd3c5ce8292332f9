"""Laws as sparse sums, found by regression alone: no simulation, no population, seconds at most.

- `weak_form`: equations integrated against test functions, so that nothing is differentiated
- `elimination`: terms left out, taken in again and spared, whatever sums are fitted to; forward selection
- `regression`: sums of products fitted to the weak form; the criterion
- `product_laws`: the laws of one state in the weak form, or on derivatives without noise, beside other programs
- `products`: libraries of products of variables, and programs that are sums of them
- `pursuit`: sums of a polynomial and of products with functions, constants inside these fitted (matching pursuit)
- `shapes`: the products with functions that it is made of
- `rates`: laws of many variables on derivatives, each row by its own error; which variables an equation takes
- `windows`: the same with noise, on short windows, with errors in all variables
- `kernels`: least squares and elimination, compiled; `warmup` makes them ready

Candidates for `selection`, which judges them by trajectories. The reasons and figures: ADR 0036, 0041, 0043 and 0048.
"""
