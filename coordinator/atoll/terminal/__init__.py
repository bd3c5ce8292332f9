"""Output on a terminal: ``output`` has lines, tables and numbers, ``progress`` the displays of a job."""
