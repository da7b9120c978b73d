"""From a named effect to a calibrated one: curves and maps that are fitted to recordings."""
