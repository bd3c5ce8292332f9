"""docs/protocol.md says what the code does: its tables are the code's, and no message is missing."""

import re
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest

from atoll_core.config import Frozen
from atoll_core.wire.messages import clients as client_messages
from atoll_core.wire.messages import epochs as epoch_messages
from atoll_core.wire.messages import handshake as greetings
from atoll_core.wire.messages import tasks as task_messages
from atoll_core.wire.messages import workers as messages

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "protocol.md").read_text("utf-8")
TABLES = re.findall(r"<!-- table: ([\w.]+) -->\n((?:\|.*\n)+)", TEXT)


def printed(path: str) -> str:
    """Return a transition table as the document prints it."""
    module, name = path.rsplit(".", 1)
    table: dict[str, dict[str, str | None]] = getattr(import_module(module), name)
    steps = list(dict.fromkeys(step for row in table.values() for step in row))
    rows = [
        [state, *((row[step] or "*gone*") if step in row else "·" for step in steps)] for state, row in table.items()
    ]
    lines = [["state", *steps], *rows]
    text = ["| " + " | ".join(line) + " |\n" for line in lines]
    return "".join([text[0], "|" + "---|" * (len(steps) + 1) + "\n", *text[1:]])


def test_all_five_machines_are_there() -> None:
    assert len(TABLES) == 5


@pytest.mark.parametrize(("path", "table"), TABLES)
def test_a_table_in_the_document_is_the_one_in_the_code(path: str, table: str) -> None:
    assert table == printed(path)


def test_every_kind_of_message_is_named() -> None:
    modules = (greetings, messages, epoch_messages, task_messages, client_messages)
    every = [value for module in modules for value in vars(module).values()]
    models = [value for value in every if isinstance(value, type) and issubclass(value, Frozen)]
    named = [get_args(model.model_fields["kind"].annotation) for model in models if "kind" in model.model_fields]
    kinds = {kind for kinds in named for kind in kinds}  # a base of several messages names none
    assert len(kinds) > 25
    assert [kind for kind in sorted(kinds) if f"`{kind}`" not in TEXT] == []
