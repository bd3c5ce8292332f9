"""What a job has found, as ``result.json`` holds it: written by the coordinator, read by everybody.

``result`` has the whole, `Result`; ``equations``, ``listed_trajectories`` and ``findings`` its parts, each a frozen
pydantic model with the keys of the file as fields; ``base`` what they share; ``reading`` takes a file apart and says in
one sentence what is wrong with it; ``upgrade`` brings files of earlier versions up to date, step by step.
docs/result-keys.md says what the keys mean, and ``result.schema.json`` beside this file says it to other programs.
"""
