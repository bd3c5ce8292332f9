"""Output on a terminal: ``output`` writes lines, tables and numbers; ``progress`` displays a running job."""
