"""
A Go1 velocity task of mjlab with two Flexx2 and a height grid as observations.

Run it where mjlab and ``flexx2_sim_ros[figures]`` are installed: ``python examples/mjlab_go1.py``.
It prints the observations of each group and draws one robot's images to ``mjlab_go1.png``.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from flexx2_sim_ros.batch import noisy_depth
from flexx2_sim_ros.batch.height_grid import HeightGrid
from flexx2_sim_ros.camera import Intrinsics
from flexx2_sim_ros.rendering.pinholes import add_camera
from flexx2_sim_ros.robots.robot import load_mounts
from mjlab.asset_zoo.robots.unitree_go1.go1_constants import get_spec
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.envs.mdp import dr
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.observation_manager import ObservationGroupCfg, ObservationTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg
from mjlab.sensor import CameraSensorCfg
from mjlab.tasks.velocity.config.go1.env_cfgs import unitree_go1_rough_env_cfg
import mujoco
import numpy as np
import torch
import warp as wp

USECASE = 'Mode_5_45fps'  # the mode whose rate is nearest to the 50 Hz of the policy
CAMERAS = tuple(mount.name for mount in load_mounts())
# Metres ahead and to the left of the trunk: what the two cameras see of the ground.
AHEAD, LEFT = np.arange(0.6, 1.61, 0.1), np.arange(-0.5, 0.51, 0.1)
UNSEEN = -0.3  # height of cells that no camera sees: the ground below a standing robot, metres


def robot(lens: Intrinsics) -> mujoco.MjSpec:
    """Return mjlab's Go1 with the two cameras on its trunk."""
    spec = get_spec()
    for mount in load_mounts():
        add_camera(spec.body('trunk'), mount.name, mount.position, mount.rotation, lens)
    return spec


class DepthImages:
    """
    Depth images of one camera of the scene, as `noisy_depth` wants them.

    Parameters
    ----------
    name : str
        The camera.

    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, env: ManagerBasedRlEnv) -> torch.Tensor:
        """Return (N, H, W, 1) float32 metres along the optical axis, 0 without a surface."""
        return env.scene[self.name].data.depth

    def reset(self, env_ids: torch.Tensor | slice | None) -> None:
        """Forget nothing: clean images have no memory."""


class _Noisy:
    """Depth images with noise, from the same term that makes observations of them."""

    def __init__(self, clean: DepthImages, noise: dict[str, Any], env: ManagerBasedRlEnv) -> None:
        params = {'depth': clean, 'camera': noise}
        self._clean = clean
        self._term = noisy_depth()(ObservationTermCfg(func=None, params=params), env)

    def __call__(self, env: ManagerBasedRlEnv) -> torch.Tensor:
        return self._term(env, self._clean)

    def reset(self, env_ids: torch.Tensor | slice | None) -> None:
        self._term.reset(env_ids)


class GroundHeights:
    """
    An observation term: heights of the ground ahead, from the depth images of all cameras.

    Its ``params`` are ``lens``, the intrinsics of the images, and ``noise``, the arguments of
    `DepthNoise` by the camera's name, or None for a grid without noise. Seeds and names that
    are those of the images give the same noise as in the images.
    """

    def __init__(self, cfg: ObservationTermCfg, env: ManagerBasedRlEnv) -> None:
        """Make the cameras and the grid."""
        noise = cfg.params['noise']
        self._images = [DepthImages(name) for name in CAMERAS]
        if noise is not None:
            self._images = [_Noisy(image, noise[image.name], env) for image in self._images]
        model = env.sim.mj_model
        self._cameras = [model.camera(f'robot/{name}').id for name in CAMERAS]
        self._trunk = model.body('robot/trunk').id
        self._grid = HeightGrid(
            env.num_envs, cfg.params['lens'], env.device, least=4, ahead=AHEAD, left=LEFT
        )

    def __call__(self, env: ManagerBasedRlEnv, lens: Intrinsics, noise: Any) -> torch.Tensor:
        """Return (N, cells) metres above the trunk, `UNSEEN` where no camera sees the ground."""
        data = env.sim.data
        trunk, level = data.xpos[:, self._trunk], _level(data.xmat[:, self._trunk])
        optical = torch.tensor([1.0, -1.0, -1.0], device=env.device)  # from MuJoCo's axes
        self._grid.clear()
        for images, index in zip(self._images, self._cameras, strict=True):
            depth = images(env)[..., 0].contiguous()
            position = torch.einsum('nji,nj->ni', level, data.cam_xpos[:, index] - trunk)
            rotation = level.transpose(1, 2) @ (data.cam_xmat[:, index] * optical)
            self._grid.add(
                wp.from_torch(depth),
                wp.from_torch(position.contiguous(), dtype=wp.vec3f),
                wp.from_torch(rotation.contiguous(), dtype=wp.mat33f),
            )
        heights = wp.to_torch(self._grid.heights()).flatten(1)
        return torch.nan_to_num(heights, nan=UNSEEN)

    def reset(self, env_ids: torch.Tensor | slice | None = None) -> None:
        """Let the cameras forget earlier frames of these environments."""
        for images in self._images:
            images.reset(env_ids)


def _level(rotation: torch.Tensor) -> torch.Tensor:
    # (N, 3, 3): the trunk's heading, without its roll and pitch.
    yaw = torch.atan2(rotation[:, 1, 0], rotation[:, 0, 0])
    level = torch.zeros_like(rotation)
    level[:, 0, 0] = level[:, 1, 1] = torch.cos(yaw)
    level[:, 1, 0] = torch.sin(yaw)
    level[:, 0, 1] = -level[:, 1, 0]
    level[:, 2, 2] = 1.0
    return level


def task(
    num_envs: int, width: int = 224, height: int = 172, effects: Sequence[dict[str, Any]] = ()
) -> ManagerBasedRlEnvCfg:
    """
    Return the configuration of the task.

    Parameters
    ----------
    num_envs : int
        Environments.
    width, height : int
        Of the depth images; the Flexx2 has 224 x 172.
    effects : sequence of dict
        The effects of each environment's cameras; see `different_cameras`.

    Returns
    -------
    ManagerBasedRlEnvCfg

    """
    lens = Intrinsics.from_field_of_view(width, height, 56.0, 44.0)

    noise = {
        name: {'mode': USECASE, 'name': name, 'K': lens.matrix, 'effects': effects}
        for name in CAMERAS
    }
    cfg = unitree_go1_rough_env_cfg()
    cfg.scene.num_envs, cfg.seed = num_envs, 0
    # A small terrain, which a CPU builds in seconds.
    terrain = cfg.scene.terrain.terrain_generator
    terrain.num_rows, terrain.num_cols, terrain.border_width, terrain.seed = 2, 2, 5.0, 0
    terrain.size, terrain.difficulty_range = (5.0, 5.0), (0.5, 1.0)
    terrain.sub_terrains = {
        name: replace(one, platform_width=1.6, border_width=0.2)
        for name, one in terrain.sub_terrains.items()
        if 'stairs' in name
    }
    cfg.scene.entities['robot'].spec_fn = lambda: robot(lens)
    cfg.scene.sensors += tuple(
        CameraSensorCfg(
            name=name,
            camera_name=f'robot/{name}',
            width=width,
            height=height,
            data_types=('depth',),
            use_textures=False,
            enabled_geom_groups=(0, 2),  # terrain and what is to be seen of the robot
        )
        for name in CAMERAS
    )
    cfg.observations['actor'].terms['height_scan'] = ObservationTermCfg(
        func=GroundHeights, params={'lens': lens, 'noise': noise}
    )
    cfg.observations['critic'].terms['height_scan'] = ObservationTermCfg(
        func=GroundHeights, params={'lens': lens, 'noise': None}
    )
    cfg.observations['images'] = ObservationGroupCfg(
        terms={
            name: ObservationTermCfg(
                func=noisy_depth(), params={'depth': DepthImages(name), 'camera': noise[name]}
            )
            for name in CAMERAS
        },
        concatenate_terms=False,
    )
    for name in CAMERAS:
        where = SceneEntityCfg('robot', camera_names=(name,))
        cfg.events[f'{name}_position'] = EventTermCfg(
            mode='startup',
            func=dr.cam_pos,
            params={'asset_cfg': where, 'operation': 'add', 'ranges': (-0.005, 0.005)},
        )
        cfg.events[f'{name}_direction'] = EventTermCfg(
            mode='startup',
            func=dr.cam_quat,
            params={'asset_cfg': where, 'pitch_range': (-0.02, 0.02), 'yaw_range': (-0.02, 0.02)},
        )
    return cfg


def different_cameras(count: int) -> list[dict[str, Any]]:
    """Return effects with other parameters in each environment: domain randomisation."""
    random = np.random.default_rng(0)
    return [
        {
            'offset': {'bias': float(random.uniform(-0.01, 0.01))},
            'temporal_filter': {'share': float(random.uniform(0.0, 0.5))},
        }
        for _ in range(count)
    ]


def draw(path: Path, env: ManagerBasedRlEnv, seen: dict[str, Any]) -> None:
    """Draw clean and noisy depth of one robot's cameras and its height grid."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5), layout='constrained')
    axes = figure.subplots(2, 3)
    grids = [height_grid(env, seen, group) for group in ('critic', 'actor')]
    one = int(torch.argmax(grids[0].flatten(1).std(dim=1)))  # the robot before the largest steps
    for row, name in zip(axes, CAMERAS, strict=True):
        clean = DepthImages(name)(env)[one, ..., 0].cpu().numpy()
        noisy = seen['images'][name][one, ..., 0].cpu().numpy()
        for axis, image, title in zip(row, (clean, noisy), ('mjlab', 'Flexx2'), strict=False):
            drawn = axis.imshow(np.where(image > 0, image, np.nan), vmin=0.2, vmax=2.4)
            axis.set(title=f'{name}: {title}', xticks=[], yticks=[])
        figure.colorbar(drawn, ax=row[:2], label='depth, m')
    low, high = float(grids[0][one].min()), float(grids[0][one].max())
    for axis, grid, title in zip(axes[:, 2], grids, ('without', 'with'), strict=True):
        drawn = axis.imshow(
            np.where(grid[one].cpu() == UNSEEN, np.nan, grid[one].cpu()),
            origin='lower',
            extent=(LEFT[0] - 0.05, LEFT[-1] + 0.05, AHEAD[0] - 0.05, AHEAD[-1] + 0.05),
            vmin=low - 0.01,
            vmax=high + 0.01,
        )
        axis.invert_xaxis()
        axis.set(title=f'height grid {title} noise', xlabel='left, m', ylabel='ahead, m')
        figure.colorbar(drawn, ax=axis, label='height, m')
    figure.savefig(path, dpi=100)


def height_grid(env: ManagerBasedRlEnv, seen: dict[str, Any], group: str) -> torch.Tensor:
    """Return (N, A, L) metres: the height grid within a group's observation."""
    manager = env.observation_manager
    index = manager.active_terms[group].index('height_scan')
    sizes = [int(np.prod(shape)) for shape in manager.group_obs_term_dim[group]]
    first = sum(sizes[:index])
    return seen[group][:, first : first + sizes[index]].unflatten(1, (len(AHEAD), len(LEFT)))


def main() -> None:
    """Run a few steps with random actions."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--num-envs', type=int, default=64, help='default %(default)s')
    parser.add_argument('--steps', type=int, default=5, help='default %(default)s')
    parser.add_argument('--device', default='cpu', help='cpu or cuda:0 (default %(default)s)')
    parser.add_argument('--out', type=Path, default=Path('mjlab_go1.png'), help='picture')
    arguments = parser.parse_args()
    cameras = different_cameras(arguments.num_envs)
    env = ManagerBasedRlEnv(task(arguments.num_envs, effects=cameras), device=arguments.device)
    seen, _ = env.reset()
    for _ in range(arguments.steps):
        actions = 0.2 * torch.randn(env.num_envs, env.action_manager.total_action_dim)
        seen, *_ = env.step(actions.to(env.device))
    print(env.observation_manager)
    draw(arguments.out, env, seen)
    env.close()


if __name__ == '__main__':
    main()
