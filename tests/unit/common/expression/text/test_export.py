"""Names in LaTeX: identifiers as mathematics, others as text that LaTeX prints as it stands."""

import pytest

from atoll.expression.text.export import left_side_to_latex


@pytest.mark.parametrize(
    ("lhs", "latex"),
    [
        ("dx_1/dt", r"\frac{d x_{1}}{d t}"),
        ("d2theta/dt2", r"\frac{d^{2} \theta}{d t^{2}}"),
        ("d50% a_b$/dt", r"\frac{d \text{50\% a\_b\$}}{d t}"),
        ("dx^2 #{z}/dt", r"\frac{d \text{x\textasciicircum{}2 \#\{z\}}}{d t}"),
    ],
)
def test_names_are_mathematics_or_text(lhs: str, latex: str) -> None:
    assert left_side_to_latex(lhs) == latex
