"""The questions, one file each: from the tables to short tables to read, figures and an answer with its count."""
