"""
The model's formulas on single numbers, each written once.

A formula is a plain function of float32 and whole numbers, and of flat arrays where it looks at
neighbours. It uses nothing but arithmetic, constants of NumPy's types, other formulas and the
names in `scalars`. As it stands it works on NumPy numbers and arrays. `physics.compiled` compiles
it for loops over images on the CPU, and `batch.compiled` for Warp's kernels; `Backend` is what the
two share.
"""

from flexx2_sim_ros.formulas.backend import Backend, on_images

__all__ = ['Backend', 'on_images']
