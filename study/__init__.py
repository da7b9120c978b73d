"""How good a diagnosis is: a blind camera, and the benchmark that scores answers."""
