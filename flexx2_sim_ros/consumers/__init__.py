"""
What reads depth on a robot: grids, maps, distances.

The same images, real and simulated, go through each consumer, so that a gap is known in the units
of what it costs. `Consumer` is the protocol for your own.
"""

from flexx2_sim_ros.consumers.consumer import CameraView, Consumer

__all__ = ['CameraView', 'Consumer']
