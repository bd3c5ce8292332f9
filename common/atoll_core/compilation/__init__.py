"""The kernels' compiler: its settings, where machine code is kept, and compiling once per machine.

`jit` is the one module that imports numba: decorators with strict arithmetic, and a cache that finds machine code by
the text of its sources. `cache` lists the files of kernels, and names the folder of the compiled ones of a package and
the mark that says that they are there; `warmup` compiles them once per machine, and `progress` shows how many are.

A module of kernels imports `jit`; a program calls `warmup` before work comes, with what runs its kernels.
"""
