"""Plans of recordings: what to record, what it can find, and what to record next."""
