"""Uploads, whatever sequence of messages comes: who has a table has shown all of it, and what is stored counts."""

import hashlib
from collections import Counter
from unittest import mock

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from atoll_coordinator.service.requests.uploads import LEASE_S, Uploads
from atoll_coordinator.service.store import blobs
from atoll_coordinator.service.store.jobs import JobRecord, Viewer
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RefusedError, RemoteProtocolError
from atoll_core.wire.messages import clients as messages
from atoll_core.wire.messages import limits

CHUNK = 4
"""Bytes of a chunk here, so that few bytes make several."""

TABLES = (b"aaaabbbbc", b"aaaabbbb", b"aaaa", b"zzzzbbbbc", b"q")
USERS = ("ann", "bob", None)
SESSIONS = ("s1", "s2")

USER = st.sampled_from(USERS)
TABLE = st.sampled_from(TABLES)
MESSAGE = st.one_of(
    st.tuples(st.just("whole"), USER, st.sampled_from(SESSIONS), TABLE),
    st.tuples(st.just("next"), USER, st.sampled_from(SESSIONS), TABLE, TABLE),
    st.tuples(
        st.just("send"), USER, st.sampled_from(SESSIONS), TABLE, st.integers(1, 12), st.integers(0, 3),
        st.none() | st.sampled_from([table[n : n + size] for table in TABLES for n in (0, 4, 8) for size in (1, 4)]),
    ),
    st.tuples(st.just("submit"), USER, st.sampled_from(SESSIONS), TABLE),
    st.tuples(st.just("delete"), st.integers(0, 3)),
    st.tuples(st.just("wait"), st.sampled_from([LEASE_S / 2, LEASE_S + 1.0])),
    st.tuples(st.just("restart")),
)  # fmt: skip


class Users:
    """Users who upload, and what they have shown by a second account of it: the bytes that each has sent at all."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.now = 0.0
        self.jobs = 0
        self.sent: dict[object, set[tuple[int, bytes]]] = {}
        self.uploads = Uploads(store, lambda: self.now)

    def do(self, kind: str, *values: object) -> None:
        getattr(self, kind)(*values)

    def send(self, user: str | None, session: str, of: bytes, size: int, index: int, data: bytes | None) -> object:
        """Send a chunk, which may fit or not, of a table that is announced with any size."""
        sha256 = hashlib.sha256(data).hexdigest() if data is not None else None
        upload = messages.Upload(blob=digest_of(of), size=size, index=index, sha256=sha256, data=data)
        if data is not None:
            self.sent.setdefault((user, None if user else session), set()).add((index, data))
        viewer = Viewer(user) if user is not None else None
        try:
            return self.uploads.take(upload, user, viewer, session)
        except (RefusedError, RemoteProtocolError) as error:
            return error

    def next(self, user: str | None, session: str, of: bytes, data: bytes) -> None:
        """Send the chunk that is asked for, which may be another table's."""
        answer = self.send(user, session, of, len(of), 0, None)
        if isinstance(answer, messages.Uploaded) and answer.missing:
            index = answer.missing[0]
            self.send(user, session, of, len(of), index, data[index * CHUNK : (index + 1) * CHUNK])

    def whole(self, user: str | None, session: str, of: bytes) -> None:
        """Send what is missing until nothing is, as clients do: nobody else can keep it from coming to its end."""
        for _ in range(2 * limits.chunk_count(len(of)) + 1):  # what was sent before may have been wrong
            answer = self.send(user, session, of, len(of), 0, None)
            assert isinstance(answer, messages.Uploaded)
            if not answer.missing:
                break
            self.next(user, session, of, of)
        else:
            raise AssertionError("an upload whose chunks are right came to no end")

    def submit(self, user: str | None, session: str, of: bytes) -> None:
        viewer = Viewer(user) if user is not None else None
        if self.uploads.has(digest_of(of), user, viewer, session) and self.store.has_blob(digest_of(of)):
            self.jobs += 1
            self.store.add_job(JobRecord(f"j{self.jobs}", "", "{}", digest_of(of), "2026", submitter=user))
            self.uploads.end(digest_of(of), user, session)

    def delete(self, number: int) -> None:
        job = f"j{number}"
        if self.store.job(job) is not None:
            self.store.commit_result(job, "done", "{}")
            self.store.delete_job(job)

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.uploads.expire()

    def restart(self) -> None:
        self.uploads = Uploads(self.store, lambda: self.now)
        self.uploads.delete_all()

    def check(self) -> None:
        for user in ("ann", "bob"):
            for table in TABLES:
                if self.uploads.has(digest_of(table), user, Viewer(user), ""):
                    own = self.sent.get((user, None), set())
                    assert all(piece in own for piece in chunks_of(table)), (user, table)
        pending = Counter({user: self.uploads.pending_bytes(user, "", "")[0] for user in USERS})
        sizes = "SELECT digest, sum(length(data)) FROM chunks GROUP BY digest"
        stored = dict(self.store._connection.execute(sizes).fetchall())
        assert self.store.blob_bytes() == sum(stored.values())
        assert self.uploads.pending_bytes(None, "", "")[1] == pending.total()
        assert self.uploads._begun == Counter(who[1:] for who in self.uploads._uploads)
        own_names = {own.digest if own.is_whole else own.key for own in self.uploads._uploads.values()}
        assert set(self.store.unused_blobs()) <= own_names, "bytes are stored that count for nobody"
        for own in self.uploads._uploads.values():
            name = own.digest if own.is_whole else own.key
            size = stored.get(name, own.sent)  # a table whose last job was deleted may be gone
            assert own.sent == size or (own.sent < size and self.store.has_blob(name))


def chunks_of(table: bytes) -> list[tuple[int, bytes]]:
    return [(n, table[n * CHUNK : (n + 1) * CHUNK]) for n in range(limits.chunk_count(len(table)))]


def digest_of(table: bytes) -> str:
    return hashlib.sha256(table).hexdigest()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(MESSAGE, max_size=25))
def test_who_has_a_table_has_shown_all_of_it_and_quotas_are_what_is_stored(sequence: list[tuple[object, ...]]) -> None:
    with (
        mock.patch.object(limits, "CHUNK_SIZE", CHUNK),
        mock.patch.object(blobs, "CHUNK_SIZE", CHUNK),
        Store.open(None) as store,
    ):
        users = Users(store)
        for message in sequence:
            users.do(*message)  # type: ignore[arg-type]
            users.check()
