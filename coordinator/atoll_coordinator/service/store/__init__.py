"""The coordinator's durable memory: one SQLite file, ``atoll.sqlite3``.

`store` is the interface, one transaction a method; its parts are `jobs`, `searches`, `blobs`, `events` and `holdings`.
`open_file` runs transactions; `schema` creates, checks and migrates the file; `lock` keeps other coordinators out, and
`standby` waits for the lock; `backup` copies a store; `retention` says which ended jobs are kept.
"""
