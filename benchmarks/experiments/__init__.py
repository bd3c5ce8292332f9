"""What the data leave open: ``python -m benchmarks.experiments.coverage`` measures intervals of constants."""
