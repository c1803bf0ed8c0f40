"""The regression gate: accuracy against the committed tables, speed against an older revision."""
