"""``coordinator result``: the equations of a job, in the form that is asked for; of a running job, the best so far.

The job is one of a coordinator, or a saved ``result.json``.
"""

import argparse
import os
from pathlib import Path

from atoll.cli.exit_codes import DONE
from atoll.cli.request import CONNECT_LIMIT_S, address_of
from atoll.client.client import connected
from atoll.terminal.output import as_json, say
from atoll_coordinator.result.reading import RESULT
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError


def result(options: argparse.Namespace) -> int:
    """Print the result of ``options.job``, an id or the path of a saved result."""
    if options.json and options.format not in (None, "json"):
        raise UsageError(f"--json and --format {options.format} contradict each other; give one of them")
    path = Path(options.job)
    if path.suffix == ".json" or (path / RESULT).is_file():
        shown = Result.load(path)
    else:
        if not (options.connect or os.environ.get("ATOLL_CONNECT")):
            found_nothing = f"{options.job} is no saved result, and no coordinator was named to look for such a job"
            raise UsageError(f"{found_nothing}; give PATH/result.json, or --connect tcp/HOST:PORT")
        with connected(address_of(options), CONNECT_LIMIT_S) as client:
            shown = Result.of(client.result(client.resolve(options.job)))
    from atoll.text.render import parse_picks, pick, render, render_text

    chosen = pick(shown, parse_picks(options.pick)) if options.pick else shown
    if options.json or options.format == "json":
        say(as_json(chosen.as_dict()))
    elif options.format in (None, "text"):
        reason = f": {chosen.reason}" if chosen.reason else ""
        heading = "" if chosen.state == "done" else f"job {chosen.job} is {chosen.state}{reason}\n"
        say(heading + render_text(chosen, fronts=True))
    else:
        say(render(chosen, options.format))
    return DONE
