"""Kernels as machine code: `jit` compiles them. `cache` chooses their folder and compiles them once per machine."""
