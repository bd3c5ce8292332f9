"""In a notebook, progress stands in one output, which is written anew when it changes."""

import sys
from types import ModuleType

import pytest

from atoll.api.discover import _display
from atoll.api.notebook_progress import NotebookDisplay
from atoll_core.wire.messages.views import JobView, Workforce

VIEW = JobView(
    job="j", name="a<b", state="queued", seed=0, preset="default", submitted="", elapsed=1.0, workers=1,
    point_evaluations=0,
)  # fmt: skip


class Handle:
    def __init__(self) -> None:
        self.shown: list[str] = []

    def update(self, what: str) -> None:
        self.shown.append(what)


@pytest.fixture
def handle(monkeypatch: pytest.MonkeyPatch) -> Handle:
    """The output of a kernel, as `IPython.display.display` returns it."""
    handle, module = Handle(), ModuleType("IPython.display")
    module.HTML = str  # type: ignore[attr-defined]
    module.display = lambda *_, **__: handle  # type: ignore[attr-defined]
    parent = ModuleType("IPython")
    parent.display = module  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", parent)
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    return handle


def test_what_has_not_changed_is_not_written_again(handle: Handle) -> None:
    with _display(None) as display:
        assert isinstance(display, NotebookDisplay)
        display.show(VIEW, Workforce(), 0.0)
        display.show(VIEW, Workforce(), 1.0)
        display.show(VIEW.model_copy(update={"state": "running"}), Workforce(), 2.0)
    assert [text.split()[2].rstrip(",") for text in handle.shown] == ["queued", "running"]


@pytest.mark.usefixtures("handle")
def test_nothing_is_shown_where_nobody_wants_it() -> None:
    assert not isinstance(_display(False), NotebookDisplay)
