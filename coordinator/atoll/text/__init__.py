"""A result as text for people: `render` the whole, `tables` its tables, `process` what is said of a process."""
