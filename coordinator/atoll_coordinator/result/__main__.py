"""``python -m atoll_coordinator.result`` writes ``result.schema.json`` anew, after a change of the parts."""

from pathlib import Path

from atoll_coordinator.result.result import schema_text

Path(__file__).with_name("result.schema.json").write_text(schema_text(), "utf-8")
