"""The reflectivity of surfaces at the camera's wavelength."""

from pathlib import Path

from flexx2_sim_ros.config_file import read_section
from flexx2_sim_ros.errors import InputError, shown
from flexx2_sim_ros.paths import config_dir
import mujoco
import numpy as np

# MuJoCo's default colour: a geom of this colour takes the colour of its material.
_NO_COLOUR = np.array([0.5, 0.5, 0.5, 1.0], np.float32)


def load_materials(path: str | Path | None = None) -> dict[str, float]:
    """
    Read the diffuse reflectivities at 940 nm, 0 to 1, by material name.

    The file is like ``config/materials.yaml``, which is the default. Raises InputError when it
    cannot be read or an entry is not a number from 0 to 1.
    """
    path = config_dir() / 'materials.yaml' if path is None else Path(path)
    entries = read_section(path, 'materials', dict)
    table = {}
    for name, entry in entries.items():
        value = entry.get('reflectivity') if isinstance(entry, dict) else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 1:
            raise InputError(
                f'{path}: materials.{name}.reflectivity: must be a number from 0 to 1, '
                f'got {shown(value)}'
            )
        table[str(name)] = float(value)
    return table


def reflectivity_table(
    model: mujoco.MjModel, materials: dict[str, float] | None = None
) -> np.ndarray:
    """
    Return every geom's reflectivity at 940 nm, to be indexed with a renderer's ``geom_id``.

    It is (ngeom + 1,) float32, 0 to 1. A geom without a listed material takes the Rec. 709
    luminance of its colour. The last entry, which id -1 picks, is 0. ``materials`` is reflectivity
    by name, of which the part after the last ``/`` counts; default `load_materials()`.
    """
    materials = load_materials() if materials is None else materials
    table = np.zeros(model.ngeom + 1, np.float32)
    for geom in range(model.ngeom):
        material = model.geom_matid[geom]
        rgba = model.geom_rgba[geom]
        name = ''
        if material >= 0:
            name = model.mat(material).name.rsplit('/', 1)[-1]
            if np.array_equal(rgba, _NO_COLOUR):
                rgba = model.mat_rgba[material]
        table[geom] = materials.get(name, float(rgba[:3] @ (0.2126, 0.7152, 0.0722)))
    return table.clip(0.0, 1.0)
