"""Contests with public data: ``python -m benchmarks.contests ctf|llm_sr --data DIR``.

The data are read from a folder outside of the project. ``ctf`` is the Common Task Framework's Lorenz contest, whose
shapes and scores are in ``protocol``; ``llm_sr`` are the four problems of LLM-SR
(``growth.toml``, ``metal.toml`` and ``heavy_tails.toml`` have settings for two of them). The test sets are not used:
rows of the train sets are held out in the same way.
"""
