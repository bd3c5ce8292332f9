"""The verbs that copy a coordinator's store while it is served, and make a store of a copy."""

import argparse
from pathlib import Path

from atoll.cli.exit_codes import DONE
from atoll.terminal.output import as_json, say
from atoll_core.signals import raising_interrupts


def backup(options: argparse.Namespace) -> int:
    """Copy the store in ``options.state`` into the file ``options.file``."""
    from atoll_coordinator.service.store.backup import back_up

    target = Path(options.file)
    with raising_interrupts():
        copy = back_up(Path(options.state), target)
    facts = {"file": str(target), "cluster": copy.cluster, "jobs": copy.jobs, "bytes": copy.size}
    text = f"{target}: a copy of {options.state}, checked; jobs {copy.jobs}, {copy.size / 1e6:.1f} MB"
    say(as_json(facts) if options.json else text)
    return DONE


def restore(options: argparse.Namespace) -> int:
    """Make the store in ``options.state`` of the copy ``options.file``."""
    from atoll_coordinator.service.store.backup import restore as restored

    with raising_interrupts():
        store = restored(Path(options.file), Path(options.state), replaces=options.replace)
    former = str(store.former) if store.former is not None else None
    facts = {
        "state": options.state, "cluster": store.cluster, "of": store.copy.cluster, "jobs": store.copy.jobs,
        "former": former, "aside": [str(path) for path in store.aside],
    }  # fmt: skip
    lines = [
        f"{options.state}: restored from {options.file}, jobs {store.copy.jobs}; start it with: "
        f"coordinator serve --state {options.state}",
        f"it is cluster {store.cluster} from now on; if {store.copy.cluster} is still served elsewhere, both go on "
        "with the same jobs, and neither knows of the other",
    ]
    lines += (
        [f"the store that was there is {former}; remove it when you no longer need it"] if former is not None else []
    )
    if store.aside and former is None:
        lines.append(
            "of a store that was moved away these were left, and are put aside with what it had written last: "
            f"{', '.join(map(str, store.aside))}; to open that store, move them beside it under its name"
        )
    say(as_json(facts) if options.json else "\n".join(lines))
    return DONE
