"""Chromium as tests start it, and what axe is asked for."""

import shutil

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SWITCHES = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
WIDTHS = (1280, 390)
OPTIONS = {"resultTypes": ["violations"], "preload": False}
"""Of axe: it would load style sheets a second time, by requests that files may not make."""
SERIOUS = ("serious", "critical")
