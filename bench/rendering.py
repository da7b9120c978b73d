"""The time of rendering the built-in scene, per camera."""

from bench.timing import peak_megabytes, side_by_side
from flexx2_sim_ros.camera import flexx2
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.rendering.renderer import open_renderer
from flexx2_sim_ros.robots.model import build_model, stand
from flexx2_sim_ros.robots.robot import load_mounts
import mujoco


def run(rounds: int = 60) -> None:
    """Print milliseconds per camera for every backend that works on this machine."""
    intrinsics = flexx2().intrinsics
    model = build_model(intrinsics=intrinsics)
    data = mujoco.MjData(model)
    stand(model, data)
    names = [mount.name for mount in load_mounts()]
    print(f'built-in Go1 in lab, {intrinsics.width} x {intrinsics.height}, {model.ngeom} geoms')
    for backend in ('egl', 'osmesa', 'ray'):
        try:
            renderer = open_renderer(model, intrinsics, backend)
        except InputError as error:
            print(f'{backend:8s} not here: {error}')
            continue
        functions = {
            name: (lambda camera=name, by=renderer: by.render(data, camera)) for name in names
        }
        times = side_by_side(functions, rounds)
        renderer.close()
        print(f'{backend:8s} ' + ', '.join(f'{name} {ms:.2f} ms' for name, ms in times.items()))
    print(f'wanted: OpenGL below 8 ms a camera; peak memory {peak_megabytes():.0f} MB')
