"""Keys: what is built is parsed back, and nothing else is parsed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.wire import topics

IDS = st.from_regex(topics.ID, fullmatch=True)
DIGESTS = st.from_regex(topics.DIGEST, fullmatch=True)
PARTS = st.sampled_from(["alive", "status", "report", "pull", "log"])


@pytest.mark.slow
@given(IDS, IDS, DIGESTS, st.integers(0, topics.MAX_CHUNKS - 1), PARTS)
def test_every_key_that_is_built_is_parsed_back(
    cluster: str, name: str, digest: str, index: int, part: topics.WorkerPart
) -> None:
    pairs = [
        (topics.HELLO, topics.HelloKey()),
        (topics.hello(name), topics.HelloKey(name)),
        (topics.control(cluster), topics.ControlKey(cluster)),
        (topics.control(cluster, name), topics.ControlKey(cluster, name)),
        (topics.states(cluster, name), topics.StatesKey(cluster, name)),
        (topics.blob(cluster, digest, index), topics.BlobKey(cluster, digest, index)),
        (topics.worker(cluster, name, part), topics.WorkerKey(cluster, name, part)),
        (topics.client(cluster, name), topics.ClientKey(cluster, name)),
    ]
    for key, parsed in pairs:
        assert topics.parse(key) == parsed


@pytest.mark.parametrize(
    "key",
    [
        "",
        "atoll",
        "other/hello",
        "atoll/hello/x/y",
        "atoll/hello/x y",
        "atoll/r/unknown",
        "atoll/r/worker/w/other",
        "atoll/r/worker/w/to",
        "atoll/r/worker/a b/status",
        "atoll/r/blob/12/0",
        f"atoll/r/blob/{'0' * 64}/01",
        f"atoll/r/blob/{'0' * 64}/99999",
        f"atoll/{'r' * 65}/control",
        "atoll/r/client/c/ask/more",
        "a/" * 1000,
    ],
)
def test_any_other_key_is_refused(key: str) -> None:
    with pytest.raises(RemoteProtocolError, match="none of ours"):
        topics.parse(key)


@given(st.text())
def test_no_text_breaks_the_parser(key: str) -> None:
    try:
        topics.parse(key)
    except RemoteProtocolError:
        return


@pytest.mark.parametrize("name", ["", "a/b", "*", "θ", "x" * 65, "v [m/s]"])
def test_only_ids_stand_in_keys(name: str) -> None:
    with pytest.raises(LocalProtocolError, match="cannot stand in a key"):
        topics.states("cluster", name)


def test_blob_keys_need_a_digest_and_a_chunk_that_can_be() -> None:
    with pytest.raises(LocalProtocolError):
        topics.blob("cluster", "12", 0)
    with pytest.raises(LocalProtocolError):
        topics.blob("cluster", "0" * 64, -1)
