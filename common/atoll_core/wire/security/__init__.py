"""Who may do what: certificates, and the rules that a router enforces.

- ``credentials``: the authority's certificate, one's own and its key: checked when they are loaded, issued for a lab.
- ``role_bindings``: which principal has which role; ``access_control``: the rules of a router that follow from it.

Credentials are named by options or the environment, go into a `Destination` and from there into the bus; bindings are
read where a router starts. docs/protocol.md says which role may use which keys.
"""
