"""Searches on random systems: ``python -m benchmarks.corpus``.

``families`` are systems of textbooks, ``random_equations`` sums of random terms; ``systems`` draws one of either from
a seed, ``qualities`` measures it, ``cases`` puts both into what is searched and judged; ``lengths`` says whether the
data prefer the truth, ``outcomes`` judges a job; ``campaign`` runs many jobs and keeps a journal, ``tables`` sums them
up.
"""
