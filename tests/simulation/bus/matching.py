"""Which keys an expression matches, as zenoh has it."""


def matches(expression: str, key: str) -> bool:
    """Return whether the key expression matches the concrete key. Pure; linear in expression times key."""
    reachable = {0}  # numbers of chunks of the key that the part of the expression read so far can have consumed
    chunks = key.split("/")
    for wanted in expression.split("/"):
        reachable = _after(wanted, reachable, chunks)
    return len(chunks) in reachable


def _after(wanted: str, reachable: set[int], chunks: list[str]) -> set[int]:
    if wanted != "**":
        return {place + 1 for place in reachable if place < len(chunks) and _fits(wanted, chunks[place])}
    result: set[int] = set()
    for place in reachable:
        result.add(place)
        while place < len(chunks) and _fits("*", chunks[place]):
            place += 1
            result.add(place)
    return result


def _fits(wanted: str, chunk: str) -> bool:
    return wanted == chunk or (wanted == "*" and not chunk.startswith("@"))
