"""The coordinator's durable memory: one SQLite file, ``atoll.sqlite3``.

`store` is the interface; each method is one transaction. Its parts are `jobs`, `checkpoints`, `blobs`, `events` and
`holdings`. `open_file` runs transactions; `schema` creates, checks and migrates the file; `lock` lets only one
coordinator serve a store, and `standby` waits for the lock; `backup` copies a store; `retention` decides which ended
jobs are kept.
"""
