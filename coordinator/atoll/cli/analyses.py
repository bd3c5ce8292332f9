"""Questions about a result: of a saved one answered here, of a job of a coordinator by a worker."""

import argparse
from dataclasses import replace

from atoll.api.tables import table_of
from atoll.cli.request import CONNECT_LIMIT_S, address_of, is_saved, load_result
from atoll.client.client import Client, connected
from atoll.experiments.fits import config_of
from atoll.tasks.analyses import FUNCTIONS, Analysed, Question, answer, answered
from atoll.terminal.output import note
from atoll_coordinator.result.result import Result
from atoll_core.data.table import Table
from atoll_core.wire.values import encode_value


def ask(options: argparse.Namespace, *questions: Question, name: str | None = None) -> list[Analysed]:
    """Return the answers to questions about the result `name` (None: `options.result`), in order.

    With ``--data``, of measurements in the place of those of the result.
    """
    result = options.result if name is None else name
    questions = tuple(replace(question, group=options.group) for question in questions)
    files: list[str] | None = getattr(options, "data", None)
    if is_saved(result, options):
        saved = load_result(result)
        table = _table(saved, files)
        return [answer(saved, question, table) for question in questions]
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = client.resolve(result)
        table = None if files is None else _table(Result.of(client.result(job)), files)
        return [_ask(client, job, question, table) for question in questions]


def _ask(client: Client, job: str, question: Question, table: Table | None) -> Analysed:
    rows = None if table is None else table.to_bytes()
    made = client.analyse(job, FUNCTIONS[type(question)], encode_value(question), rows, _say)
    return answered(made)


def _say(reason: str) -> None:
    note(f"coordinator: the analysis {reason}")


def _table(result: Result, files: list[str] | None) -> Table | None:
    return None if files is None else table_of(files, config_of(result).data)
