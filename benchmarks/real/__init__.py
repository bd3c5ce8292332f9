"""Searches on real measurements: ``python -m benchmarks.real --data DIR``.

The files are read from a folder outside of the project. ``cases`` says which files, columns and rows make a job.
"""
