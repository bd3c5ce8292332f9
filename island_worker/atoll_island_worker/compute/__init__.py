"""The compute thread of a worker: ``compute_thread`` takes commands and posts results.

``run_queue`` decides which island is computed next, slice by slice (pure).
"""
