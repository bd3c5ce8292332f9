"""Communication of coordinator, workers and clients: messages, their bytes, and the bus that carries them.

- ``messages``: the messages as validated models. ``codec``: their bytes, and the bytes of arrays and datasets.
- ``values``: bytes of dataclasses, arrays and programs, read by the type that is expected.
- ``topics``: the keys of the bus, built and parsed. ``bus``: the interface of a bus, and Zenoh behind it.
- ``addresses``: where a coordinator is. ``security``: certificates, roles, access rules.
- ``state_pieces``: states of islands in messages. ``rejects``: counts of malformed messages.

A message goes from a model through ``codec.encode`` to `Bus.put` or `Bus.get` under a key of ``topics``; the receiver
parses the key, and ``codec.decode`` checks size, structure and model before anything acts on it. docs/protocol.md lists
keys, messages and rules.
"""
