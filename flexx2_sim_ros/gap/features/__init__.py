"""A recording and its simulations, summarised as numbers."""
