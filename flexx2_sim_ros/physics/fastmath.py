"""Elementary functions compiled for loops on the CPU; `formulas.fastmath` says how they work."""

from flexx2_sim_ros.formulas import fastmath
from flexx2_sim_ros.physics.compiled import compiled

arccos = compiled(fastmath.arccos)
log2 = compiled(fastmath.log2)
exp2 = compiled(fastmath.exp2)
power = compiled(fastmath.power)
log = compiled(fastmath.log)
cos_sin_turns = compiled(fastmath.cos_sin_turns)
arctan2 = compiled(fastmath.arctan2)
