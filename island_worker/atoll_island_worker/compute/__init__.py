"""The compute thread of a worker: ``compute_thread`` takes commands and posts results; ``run_queue`` decides whose turn
it is, slice by slice (pure)."""
