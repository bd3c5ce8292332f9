"""``python -m atoll_island_worker``: the same program as the console script."""

import sys

from atoll_island_worker.cli import main

if __name__ == "__main__":
    sys.exit(main())
