"""Progress in a notebook: one output that is written anew. IPython is there where there is a notebook."""

import html
import sys
from typing import Any

from atoll.client.follower import Display
from atoll.terminal.output import note
from atoll.terminal.progress import plain_lines
from atoll_core.wire.messages.views import JobView, Workforce


def is_notebook() -> bool:
    """Tell whether this interpreter is the kernel of a notebook."""
    return "ipykernel" in sys.modules


class NotebookDisplay(Display):
    """The lines of the plain display, in their place."""

    def __init__(self) -> None:
        import IPython.display

        ipython: Any = IPython.display
        self._html = ipython.HTML
        self._handle = ipython.display(ipython.HTML(""), display_id=True)
        self._shown: list[str] = []

    def show(self, view: JobView, workforce: Workforce, now: float) -> None:
        """Write the lines anew when they have changed."""
        del now
        lines = plain_lines(view, workforce, "")
        if lines != self._shown and self._handle is not None:
            self._shown = lines
            self._handle.update(self._html(f"<pre>{html.escape(chr(10).join(lines))}</pre>"))

    def print_note(self, sentence: str) -> None:
        """Write the sentence on stderr, which a notebook shows."""
        note(sentence)
