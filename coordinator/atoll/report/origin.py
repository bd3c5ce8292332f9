"""How to repeat the run: command, seed, digests, versions."""

import json

from atoll.report.findings import Findings
from atoll.report.markup import Child, Element, element, facts, paragraph, section


def origin(its: Findings) -> Element:
    """Return the section."""
    found = its.result
    data = found.get("data") or {}
    said: list[tuple[str, Child]] = [("Job", str(found["job"])), ("Seed", str(found["seed"]))]
    if found.get("command"):
        said.append(("Command", element("code", found["command"])))
    said.append(("Digest of the search", element("code", found["digest"])))
    if data:
        said.append(("Digest of the data (sha256)", element("code", data["digest"])))
    if found.get("config"):
        said.append(("Settings", element("code", json.dumps(found["config"], ensure_ascii=False))))
    versions = ", ".join(f"{name} {version}" for name, version in (found.get("versions") or {}).items())
    said.append(("Versions", versions))
    return section("origin", "How to repeat this", paragraph(_promise(its)), facts(said))


def _promise(its: Findings) -> str:
    """Return what gives the same digest again: not the clock."""
    cut = [each for each in its.result["equations"] if each.get("why") in ("max-time", "cancelled")]
    if not cut:
        return "The same data, settings and seed give the same digest on any number of workers and machines."
    epochs = ",".join(f"{each['variable']}={each['epoch']}" for each in cut)
    return (
        "The clock ended a search, so that another run need not end there. The same data, settings and seed with "
        f"--max-epochs {epochs} in the place of --max-time give the same digest on any number of workers and machines."
    )
