"""What preparation gives, put together: `datasets` makes the problems of the search, `recordings` the recording.

Measurements, estimates and selected rows go in, one `Preparation` comes out.
"""
