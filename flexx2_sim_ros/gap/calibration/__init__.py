"""The constants of the diagnosis."""
