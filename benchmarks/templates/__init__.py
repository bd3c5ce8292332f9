"""A known part, an unknown rest, and states that no column measures: systems, jobs and judgements."""
