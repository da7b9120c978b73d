"""Camera profiles: lens, modes and noise of a camera, and the files they are read from."""
