"""The messages, as frozen models that refuse unknown fields.

- ``handshake``: the first request and its answer, which other versions can read.
- ``workers``: coordinator and workers: control, heartbeat.
- ``epochs``: results of epochs: reports, migrants, states, and the pulls for them. ``tasks``: leases and batches.
- ``clients``: requests of clients and their answers. ``views``: jobs and workers as clients see them.
- ``limits``: types of fields, and limits of sizes.

An envelope names sender and receiver; its ``body`` belongs to a closed union; the field ``kind`` has its type. A change
of any message raises `atoll_core.PROTOCOL_VERSION`.
"""
