"""``coordinator result``: the equations of a job, in the form that is asked for; of a running job, the best so far.

The job is one of a coordinator, or a saved ``result.json``.
"""

import argparse

from atoll.cli.exit_codes import DONE
from atoll.cli.request import result_of
from atoll.terminal.output import as_json, say
from atoll_core.errors import UsageError


def result(options: argparse.Namespace) -> int:
    """Print the result of ``options.job``, an id or the path of a saved result."""
    if options.json and options.format not in (None, "json"):
        raise UsageError(f"--json and --format {options.format} contradict each other; give one of them")
    shown = result_of(options.job, options)
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
