"""How workers and the coordinator itself appear in lists: what they do, what they take, what went through them."""

from collections.abc import Sequence

from atoll.terminal.output import duration, table
from atoll_core.wire.messages.views import CoordinatorView, Counters, WorkerView

_HEADS = (
    "NAME", "HOST", "PID", "STATE", "ISLANDS", "SILENT", "MEMORY", "CPU", "IN", "OUT", "WAITED", "TROUBLE", "VERSION",
    "CORES", "JOINED", "DOING",
)  # fmt: skip


def worker_table(views: Sequence[WorkerView]) -> str:
    """Return the workers, one a line."""
    return table(_HEADS, [_row(view) for view in views])


def coordinator_lines(view: CoordinatorView | None) -> str:
    """Return what the coordinator says of itself, and what went through it by kind of message."""
    if view is None:
        return "the coordinator says nothing of itself"
    counters, store = view.counters, view.store
    mean = store.total_s / store.transactions if store.transactions else 0.0
    lines = [
        f"coordinator {view.version}, start {view.incarnation}, for {duration(view.seconds)}",
        f"memory {size(counters.memory_bytes)}, CPU {duration(counters.cpu_s)}, "
        f"{counters.refused} messages refused, {counters.dropped} dropped, {counters.broken} events broke",
        f"store: {store.transactions} transactions, {1000 * mean:.1f} ms each, {1000 * store.worst_s:.1f} ms at most",
    ]
    rows = [
        (entry.kind, str(entry.messages_in), size(entry.bytes_in), str(entry.messages_out), size(entry.bytes_out))
        for entry in counters.traffic
    ]
    return "\n".join([*lines, table(("KIND", "MESSAGES IN", "BYTES IN", "MESSAGES OUT", "BYTES OUT"), rows)])


def size(count: int) -> str:
    """Return a number of bytes as people read it."""
    number = float(count)
    for unit in ("B", "kB", "MB"):
        if number < 999.5:
            return f"{number:.3g} {unit}"
        number /= 1000.0
    return f"{number:.3g} GB"


def trouble(counters: Counters) -> str:
    """Return what was refused, dropped or came twice; ``-`` when there is none of it."""
    counts = (("refused", counters.refused), ("dropped", counters.dropped), ("twice", counters.duplicates))
    return ", ".join(f"{count} {name}" for name, count in counts if count) or "-"


def _state(view: WorkerView) -> str:
    return view.state if view.service == "open" else f"{view.state}, {view.service}"


def _row(view: WorkerView) -> tuple[str, ...]:
    counters = view.counters
    doing = f"{view.doing}, {view.standing:.0f} s without progress" if view.standing >= 5.0 else view.doing
    return (
        view.worker, view.host, str(view.pid), _state(view), str(view.islands), f"{view.silent:.1f} s",
        size(counters.memory_bytes), duration(counters.cpu_s),
        size(sum(entry.bytes_in for entry in counters.traffic)),
        size(sum(entry.bytes_out for entry in counters.traffic)),
        duration(counters.waited_s), trouble(counters), view.version, str(view.cores),
        duration(view.joined), doing or view.detail,
    )  # fmt: skip
