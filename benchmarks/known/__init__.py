"""What is known of constants: groups of runs that obey one law with constants of their own, and bounds that are met."""
