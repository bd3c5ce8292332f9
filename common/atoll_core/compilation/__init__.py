"""The kernels' compiler: its settings, where machine code is kept, and compiling once per machine.

`jit` is the one module that imports numba: decorators with strict arithmetic, and a cache that finds machine code by
the text of its sources. `sources` lists the files of kernels and gives their digest; `cache` names the folder of
compiled kernels of a package and the mark that says that they are there; `warmup` compiles them once per machine, and
`progress` shows how many are compiled.

A module of kernels imports `jit`; a program calls `warmup` before work comes, with what runs its kernels.
"""
