"""The choice of a compiled function by a code."""

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.operator_choice import choose


@inlined
def _otherwise(code, a, b):
    return float(code)


CHOICE = choose({3: inlined(lambda a, b: a + b), 7: inlined(lambda a, b: a * b)}, _otherwise)


@kernel
def chosen(code: int, a: float, b: float) -> float:
    return CHOICE(code, a, b)


def test_the_branch_of_the_code_is_taken():
    assert [chosen(code, 2.0, 5.0) for code in (3, 7)] == [7.0, 10.0]


def test_without_a_branch_the_rest_is_given_the_code():
    assert chosen(5, 2.0, 5.0) == 5.0
