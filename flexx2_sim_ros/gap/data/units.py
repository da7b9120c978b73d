"""Scales that the amplitude of a recording may have."""

from pathlib import Path

from flexx2_sim_ros.camera import Mode
from flexx2_sim_ros.gap.calibration.data import READING
from flexx2_sim_ros.gap.data.frames import surface_of
from flexx2_sim_ros.physics.reflectance import falloff
import numpy as np


def largest(amplitude: np.ndarray) -> float:
    """Return the largest floating-point amplitude; 0 for whole numbers, which give the scale."""
    return float(np.nanmax(amplitude, initial=0)) if amplitude.dtype.kind == 'f' else 0.0


def guessed_scale(brightest: float) -> float:
    """Return the full scale of floating-point amplitudes that go up to a value."""
    return next((scale for scale in (1.0, 255.0) if brightest <= scale), 65535.0)


def reflectivity_from(
    amplitude: np.ndarray,
    clean: np.ndarray,
    K: np.ndarray,
    mode: Mode,
    full_scale: float | None,
    path: Path,
    notes: list[str],
) -> np.ndarray | None:
    """
    Return the reflectivity that the amplitude implies, like `clean`, 0 where unknown.

    Full scale (8 or 16 bits) is taken for a white pixel of the camera's gray image. The result may
    exceed 1, because the amplitude has the camera's own unit. It is None if the amplitude is on an
    unknown scale.

    * `amplitude`: (H, W) or (T, H, W), whole numbers or floating point.
    * `clean`: (H, W) or (T, H, W) float32 metres, NaN where unknown.
    * `full_scale`: the floating-point amplitude that is the camera's full scale; None: guessed
      from these values.
    * `notes`: what was assumed is added, with the recording's path.
    """
    sensor = mode.sensor
    if amplitude.dtype.kind in 'iu':
        full = 255.0 if amplitude.dtype.itemsize == 1 else 65535.0
    else:
        brightest = largest(amplitude)
        full = guessed_scale(brightest) if full_scale is None else full_scale
        notes.append(f'{path}: amplitude: up to {brightest:.4g}: taken for 0 to {full:g}')
    scale = np.float32(sensor.full_scale_amplitude / full)
    image = amplitude.astype(np.float32)
    image = np.nanmean(image, axis=0) if image.ndim == 3 and clean.ndim == 2 else image
    depths = clean if clean.ndim == 3 else clean[None]
    images = image if image.ndim == 3 else np.broadcast_to(image, depths.shape)
    out = []
    for one, depth in zip(images, depths, strict=True):
        out.append(one * falloff(depth, surface_of(depth, K, sensor).cos_incidence))
    reflectivity = np.nan_to_num(np.stack(out)) * scale
    some = reflectivity[(reflectivity > 0) & np.isfinite(reflectivity)]
    usual = float(np.median(some[:: max(len(some) // 100_000, 1)])) if len(some) else 1.0
    if not READING.reflectivities[0] < usual < READING.reflectivities[1]:
        notes.append(
            f'{path}: amplitude: not used: at this distance it means a reflectivity of '
            f'{usual:.2g}, so it is on another scale; 8 or 16 bits or 0 to 1 are known'
        )
        return None
    return np.clip(reflectivity, 0, 1e3).reshape(clean.shape)
