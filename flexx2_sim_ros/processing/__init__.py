"""What a robot's own program does to depth images, the same on simulated and on real ones."""

from flexx2_sim_ros.processing.chain import Chain, load_chain, parse_chain
from flexx2_sim_ros.processing.stage import option, Stage

__all__ = ['Chain', 'Stage', 'load_chain', 'option', 'parse_chain']
