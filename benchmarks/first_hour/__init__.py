"""A hundred tables as people hand them over in the first hour: ``python -m benchmarks.first_hour``.

`cases` lists them, each with the laws that it obeys, or none, and whether the data identify them; `tables` makes what
is measured; `outcomes` judges what came of each job; `campaign` runs the jobs and prints the figures.
"""
