"""Permissions: `credentials` checks certificates, `roles` reads the roster and makes the router's access rules."""
