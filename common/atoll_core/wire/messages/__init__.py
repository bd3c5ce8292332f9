"""The messages, as frozen models that refuse unknown fields; an envelope names who speaks to whom.

- ``handshake``: the first question and its answer, which versions that differ can read.
- ``workers``: coordinator and workers: control, heartbeat.
- ``epochs``: what comes of epochs: reports, migrants, states, and the pulls for them.
- ``clients``: requests of clients and their answers. ``views``: what is shown of jobs and workers.
- ``limits``: what fields may hold, and how large messages may be.

A change of any of them raises `atoll.PROTOCOL_VERSION`.
"""
