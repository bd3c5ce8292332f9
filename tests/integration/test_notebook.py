"""A notebook shows progress and equations; it is run where nbclient and ipykernel are installed."""

from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")

DATA = Path(__file__).resolve().parents[2] / "examples" / "lotka_volterra.csv"
CELL = f"import atoll\nmodel = atoll.discover({str(DATA)!r}, workers=1)\nmodel"


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of the notebook's own libraries
def test_a_notebook_shows_progress_and_latex(tmp_path: Path) -> None:
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    nbclient.NotebookClient(notebook, timeout=200, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = notebook.cells[0].outputs
    (progress,) = (output for output in outputs if output.output_type == "display_data")
    assert "x*(3 - x - 2*y)" in progress.data["text/html"]
    (shown,) = (output for output in outputs if output.output_type == "execute_result")
    assert shown.data["text/latex"].startswith("$\\displaystyle \\begin{aligned}\\frac{d x}{d t}")
    assert "<math" in shown.data["text/html"]
    assert list(tmp_path.iterdir()) == []
