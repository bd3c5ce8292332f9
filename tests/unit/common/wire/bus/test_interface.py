"""Keys match as zenoh's do."""

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from atoll_core.errors import LocalProtocolError
from atoll_core.wire.bus.interface import MAX_PAYLOAD, check_expression, check_key, check_payload
from tests.simulation.bus.matching import matches

CHUNKS = st.sampled_from(["a", "b", "ab", "@a", "θ x"])
KEYS = st.lists(CHUNKS, min_size=1, max_size=6).map("/".join)
EXPRESSIONS = (
    st.lists(CHUNKS | st.sampled_from(["*", "**"]), min_size=1, max_size=6)
    .map("/".join)
    .filter(lambda text: not any(pair in text for pair in ("**/**", "**/*")))
)


@given(EXPRESSIONS, KEYS)
def test_an_expression_matches_the_keys_that_zenoh_says_it_does(expression: str, key: str) -> None:
    check_expression(expression)
    check_key(key)
    assert matches(expression, key) == zenoh.KeyExpr(expression).intersects(zenoh.KeyExpr(key))


@given(st.text(st.sampled_from("ab/*@$#?"), max_size=7))
def test_what_we_accept_zenoh_accepts(text: str) -> None:
    try:
        check_expression(text)
    except LocalProtocolError:
        return
    assert str(zenoh.KeyExpr(text)) == text


def test_a_payload_beyond_the_limit_is_our_own_error() -> None:
    check_payload("a", bytes(10))
    with pytest.raises(LocalProtocolError, match="more than"):
        check_payload("a", bytes(MAX_PAYLOAD + 1))
