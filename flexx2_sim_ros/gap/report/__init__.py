"""The files, page and sentences that report a diagnosis."""
