"""No decision depends on the time of day: clocks that jump change nothing. Waiting goes by the monotonic clock."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("common", "coordinator", "island_worker")
WALL_CLOCKS = {
    "time": {"time", "time_ns", "localtime", "gmtime", "ctime", "strftime", "asctime"},
    "datetime": {"now", "utcnow", "today", "fromtimestamp"},
    "date": {"today", "fromtimestamp"},
}

FOR_PEOPLE = {
    "common/atoll_core/logs.py": {"_time"},
    "common/atoll_core/wire/security/credentials.py": {"load"},
    "coordinator/atoll/cli/doctor.py": {"_greeting_findings", "check_certificates"},
    "coordinator/atoll_coordinator/service/tasks/background.py": {"iso_now"},
    "island_worker/atoll_island_worker/job_logs.py": {"line_of"},
}
"""Functions that ask for the time of day, by file: what they return is shown and stored, and decides about no job. The
dates in certificates are those of the world."""


def asking(source: str) -> Iterator[str]:
    """Yield the names of functions in which the time of day is asked for ("" outside of any)."""
    if not re.search(r"\b(date|datetime|time)\b\s*(\.|import)", source):
        return iter(())

    def visit(node: ast.AST, function: str) -> Iterator[str]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            function = node.name
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name | ast.Attribute):
            owner = node.value.id if isinstance(node.value, ast.Name) else node.value.attr
            if node.attr in WALL_CLOCKS.get(owner, ()):
                yield function
        if isinstance(node, ast.ImportFrom) and node.module == "time":
            yield from (function for name in node.names if name.name in WALL_CLOCKS["time"])
        for child in ast.iter_child_nodes(node):
            yield from visit(child, function)

    return visit(ast.parse(source), "")


def test_only_what_is_for_people_asks_for_the_time_of_day() -> None:
    calls: dict[str, set[str]] = {}
    for package in PACKAGES:
        for file in sorted((ROOT / package).rglob("*.py")):
            functions = set(asking(file.read_text("utf-8")))
            if functions:
                calls[str(file.relative_to(ROOT))] = functions
    assert calls == FOR_PEOPLE


def test_every_way_to_ask_is_seen() -> None:
    source = """
import time, datetime
from time import time as now
def one(): return time.time()
def two(): return datetime.datetime.now()
def three(): return datetime.date.today()
def four(): return time.monotonic()
def five(): return time.strftime("%H")
"""
    assert list(asking(source)) == ["", "one", "two", "three", "five"]
