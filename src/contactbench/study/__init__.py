"""The experiments, one file a question: cells to be run and the rows of each; and what runs them.

`experiment` declares one, `runner` runs them in processes of its own; ``bench/`` runs the same ones under pytest.
"""
