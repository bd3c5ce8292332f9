"""Kernels as machine code: `jit` compiles them. `cache` chooses their folder and compiles them once per machine, and
`progress` says how far this is. `prebuilt` finds the kernels that a wheel brings."""
