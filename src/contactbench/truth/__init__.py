"""The truth: closed forms, frozen high-precision files, live high-precision solutions."""
