"""Kernels as machine code: `jit` compiles them, `cache` says where they are kept and compiles them once a machine."""
