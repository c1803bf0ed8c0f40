"""What is run, one file a table: cells, and the rows of each; ladders, journal, times."""
