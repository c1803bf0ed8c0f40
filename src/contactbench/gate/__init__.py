"""The regression gate: compare tables and speed with an older revision."""
