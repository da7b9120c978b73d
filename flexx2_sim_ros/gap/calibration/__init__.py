"""The constants of the diagnosis, in sections."""
