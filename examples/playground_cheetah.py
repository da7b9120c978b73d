"""
Depth images by MJX rays in environments of mujoco_playground, each with the noise of a Flexx2.

Run it where playground and ``flexx2_sim_ros[figures]`` are installed:
``python examples/playground_cheetah.py``.
``mjx.ray`` returns how many lengths of the ray's direction a surface is away, and -1 where it hits
nothing. With directions of length 1 this is the distance along the ray. With directions whose part
along the optical axis is 1 it is depth, as here. MJX casts no rays at height fields.
"""

import argparse
from pathlib import Path

from flexx2_sim_ros.batch import BatchCamera
from flexx2_sim_ros.camera import Intrinsics, ray_length
import jax
import jax.numpy as jnp
from mujoco import mjx
from mujoco_playground import MjxEnv, registry
import numpy as np
from small_room import draw, USECASE

CAMERA = 'back'  # of the environment's model: behind the cheetah and above it


def lens(width: int, height: int) -> Intrinsics:
    """Return a pinhole with the view angles of the Flexx2."""
    return Intrinsics.from_field_of_view(width, height, 56.0, 44.0)


def build(num_envs: int) -> tuple[MjxEnv, mjx.Data]:
    """Return the environment and the states of N of them after a reset."""
    env = registry.load('CheetahRun', config_overrides={'impl': 'jax'})
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), num_envs))
    return env, state.data


def directions(view: Intrinsics) -> jax.Array:
    """Return (H * W, 3): directions of the pixels' rays in MuJoCo's axes, 1 m deep each."""
    v, u = np.mgrid[: view.height, : view.width]
    x, y = (u - view.cx) / view.fx, (v - view.cy) / view.fy
    return jnp.asarray(np.stack([x, -y, -np.ones(u.shape)], axis=-1).reshape(-1, 3), jnp.float32)


def cast(env: MjxEnv, states: mjx.Data, rays: jax.Array) -> jax.Array:
    """Return (N, H * W) float32: lengths of each ray's direction to a surface, or -1."""
    camera = env.mj_model.camera(CAMERA).id

    def one(data: mjx.Data) -> jax.Array:
        along = rays @ data.cam_xmat[camera].T
        eye = data.cam_xpos[camera]
        return jax.vmap(lambda ray: mjx.ray(env.mjx_model, data, eye, ray)[0])(along)

    return jax.jit(jax.vmap(one))(states)


def main() -> None:
    """Simulate a camera in each environment and draw the first."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--num-envs', type=int, default=4, help='default %(default)s')
    parser.add_argument('--out', type=Path, default=Path('playground_cheetah.png'), help='picture')
    arguments = parser.parse_args()
    view = lens(224, 172)
    shape = (view.height, view.width)
    clean = cast(*build(arguments.num_envs), directions(view)).reshape(-1, *shape)
    seen = BatchCamera(arguments.num_envs, USECASE, K=view.matrix)(clean)  # a JAX array, too
    first = np.where(clean[0] > 0, clean[0], np.nan)
    difference = first * (ray_length(view.matrix, shape) - 1.0)
    draw(arguments.out, 'range - depth, m', difference, first, np.asarray(seen[0]))
    print(f'{np.isfinite(seen).mean():.0%} of the pixels are valid; see {arguments.out}')


if __name__ == '__main__':
    main()
