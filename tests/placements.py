"""What is kept of placements, which only a person who looks into the file ever reads."""

from atoll_coordinator.service.store.store import Store


def placements_in(store: Store, job: str) -> dict[str, tuple[int, bytes | None]]:
    """Return term and placement by variable."""
    rows = store._connection.execute("SELECT variable, term, placement FROM archipelagos WHERE job = ?", (job,))
    return {variable: (term, placement) for variable, term, placement in rows.fetchall()}
