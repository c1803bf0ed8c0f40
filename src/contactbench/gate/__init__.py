"""The regression gate: tables against those of an older revision, by column rules; speed in pairs."""
