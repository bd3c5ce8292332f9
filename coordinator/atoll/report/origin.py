"""How to repeat the run: command, seed, digests, versions."""

import json

from atoll.report.findings import Findings
from atoll.report.markup import Child, Element, element, facts, paragraph, section
from atoll_core.redaction import without_secrets


def origin(findings: Findings) -> Element:
    """Return the section."""
    result = findings.result
    entries: list[tuple[str, Child]] = [("Job", str(result.job)), ("Seed", str(result.seed))]
    if result.command:
        entries.append(("Command", element("code", without_secrets(result.command))))
    entries.append(("Digest of the search", element("code", result.digest or "")))
    if result.data is not None:
        entries.append(("Digest of the data (sha256)", element("code", result.data.digest or "")))
    if result.config:
        entries.append(("Settings", element("code", json.dumps(result.config, ensure_ascii=False))))
    versions = ", ".join(f"{name} {version}" for name, version in result.versions.items())
    entries.append(("Versions", versions))
    return section("origin", "How to repeat this", paragraph(_promise(findings)), facts(entries))


def _promise(findings: Findings) -> str:
    """Return what gives the same digest again: not the clock."""
    cut = [equation for equation in findings.result.equations if equation.why in ("max-time", "cancelled")]
    if not cut:
        return "The same data, settings and seed give the same digest on any number of workers and machines."
    epochs = ",".join(f"{equation.variable}={equation.epoch}" for equation in cut)
    return (
        "The clock ended a search, so that another run need not end there. The same data, settings and seed with "
        f"--max-epochs {epochs} in the place of --max-time give the same digest on any number of workers and machines."
    )
