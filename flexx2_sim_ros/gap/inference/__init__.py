"""Which effects explain the gap, and where it lies."""
