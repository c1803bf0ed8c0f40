"""Documents, page and figures, from the tables alone: nothing is solved here."""
