"""The result of a job as typed parts of ``result.json``: the coordinator writes it, all programs read it.

``result`` has the whole result, `Result`. ``equations``, ``listed_trajectories`` and ``findings`` have its parts:
frozen pydantic models with the keys of the file as fields; ``base`` has their common base class. ``reading`` reads a
file and reports its first error in one sentence. ``upgrade`` converts files of earlier versions, step by step.
docs/result-keys.md explains the keys, and ``result.schema.json``, next to this file, is the JSON schema for other
programs.
"""
