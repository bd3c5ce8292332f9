"""Chromium as tests start it, and what axe is asked for."""

import shutil

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SWITCHES = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
WIDTHS = (1280, 390)
NARROWEST = 340
"""Pixels of the smallest telephones: there, too, nothing is cut without a sign."""
CUT = """[...document.body.querySelectorAll('*:not(input, select, textarea)')].filter((element) => {
  const { overflowX, backgroundImage, clipPath } = getComputedStyle(element);
  const isWider = element.clientWidth > 0 && element.scrollWidth > element.clientWidth + 1;
  const isCut = clipPath === 'none' && element.checkVisibility() && isWider && overflowX !== 'visible';
  return isCut && !backgroundImage.includes('gradient');
}).map((element) => element.outerHTML.slice(0, 200))"""
"""Elements whose content goes on beyond their edge, and which have no shade there to say so."""
OPTIONS = {"resultTypes": ["violations"], "preload": False}
"""Of axe: it would load style sheets a second time, by requests that files may not make."""
SERIOUS = ("serious", "critical")
