"""A client that asks for many large answers, stops before it takes one, and stays stopped.

Arguments: where the coordinator is, its realm, the name that the client asks under, a job, the chunks of its table, how
many of them to ask for, and the credentials (authority, certificate, key), if any. The job has to be there.
"""

import os
import signal
import sys
from pathlib import Path

from atoll_core.wire import topics
from atoll_core.wire.addresses import destination
from atoll_core.wire.bus.zenoh_bus import open_client
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.clients import ClientRequest, GetTable
from atoll_core.wire.security.credentials import load

LIMIT_S = 60.0

if __name__ == "__main__":
    address, realm, name, job, chunks, count, *files = sys.argv[1:]
    credentials = load(*map(Path, files), use="connect") if files else None
    with open_client(destination(address, credentials), wait_s=LIMIT_S) as bus:
        for number in range(int(count)):
            body = GetTable(job=job, index=number % int(chunks))
            bus.get(topics.client(realm, f"{name}-{number % 3}"), encode(ClientRequest(body=body)), timeout_s=LIMIT_S)
        os.kill(os.getpid(), signal.SIGSTOP)
