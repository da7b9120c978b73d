"""A robot that walks in a MuJoCo scene, posed as the gait says."""

from flexx2_sim_ros.profiles.modes import flexx2
from flexx2_sim_ros.rendering.rays import SceneGround
from flexx2_sim_ros.robots.gait import pose, start, step
from flexx2_sim_ros.robots.kinematics import rotation
from flexx2_sim_ros.robots.model import build_model, stand
from flexx2_sim_ros.robots.parts import find_parts
from flexx2_sim_ros.robots.robot import load_robot
from flexx2_sim_ros.robots.trot import Gait
import mujoco
import numpy as np

GAIT = Gait()
LEGS = ('FR', 'FL', 'RR', 'RL')


class Walker:
    """
    A robot in a scene.

    * `model`, `data`: of MuJoCo
    * `robot`: the robot's parts
    * `ground`: of the scene
    * `state`, `pose`: of the gait, after the last step
    """

    def __init__(self, scene, robot='go1'):
        """Let a robot stand in a scene."""
        kind = load_robot(robot)
        self.model = build_model(scene=scene, intrinsics=flexx2().intrinsics, robot=kind)
        self.data = mujoco.MjData(self.model)
        stand(self.model, self.data, kind)
        self.robot = find_parts(self.model, kind)
        self.feet = [self.model.geom(f'{leg}_foot').id for leg in LEGS]
        solid = (self.model.geom_contype | self.model.geom_conaffinity) != 0
        self.solid = np.flatnonzero(solid & ~self.robot.geoms)
        self.ground = SceneGround(self.model, self.data, self.robot.geoms)
        trunk = self.data.xpos[self.robot.trunk]
        self.state = start(trunk[:2], 0.0, trunk[2], self.ground, self.robot.legs)

    def walk(self, command, seconds=1 / 30):
        """Take a step of the gait: `command` is m/s ahead, m/s to the left and rad/s."""
        command = np.array(command, float)
        self.state = step(self.state, command, seconds, self.ground, GAIT, self.robot.legs)
        self.pose = pose(self.state, GAIT, self.robot.legs)
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation(self.pose.rpy).ravel())
        self.robot.place(self.data, self.pose.position, quaternion)
        self.data.qpos[self.robot.leg_addresses] = self.pose.angles
        mujoco.mj_kinematics(self.model, self.data)

    def depth_of_feet(self):
        """Return how far the deepest foot is inside something solid, negative when it is not."""
        return -min(
            mujoco.mj_geomDistance(self.model, self.data, foot, int(geom), 0.1, None)
            for foot in self.feet
            for geom in self.solid
        )
