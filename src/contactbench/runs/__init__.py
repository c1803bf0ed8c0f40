"""Run the benchmark: one module per table yields its rows; the rest chooses settings, runs and times."""
