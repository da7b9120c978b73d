"""
The sensor: four correlation samples per pixel and frequency, and the range from them.

Tap k of a frequency collects ``ambient + A cos(phase + k pi/2)``. Light travels along rays, so
phases are those of the radial range r = z * ray length; the camera divides by the ray length
to report z.
"""

import math

from flexx2_sim_ros.physics.compiled import loop
import numpy as np

LIGHT_SPEED = 299_792_458.0
# Phase noise of the taps, radians, beyond which the base model's sigma is the surface's: a
# phasor with more noise than this has no Gaussian phase and would not unwrap.
_TAP_NOISE = 0.1


def wavenumbers(modulation_hz: tuple[float, ...]) -> np.ndarray:
    """Return phase per metre of range for each frequency, rad/m, float64."""
    return 4 * math.pi * np.array(modulation_hz) / LIGHT_SPEED


def split_noise(
    sigma_range: np.ndarray, K: np.ndarray
) -> tuple[  # noqa: N803
    np.ndarray, np.ndarray
]:
    """
    Split the base model's noise between the taps and the path of the light.

    * `sigma_range`: (H, W) standard deviation along the ray, metres
    * `K`: (J,) wavenumbers

    Returns the phase noise of each frequency, radians, and the jitter of the path, metres; (H, W)
    float32. Together they give `sigma_range` after the frequencies are combined.
    """
    total = np.sqrt((K**2).sum())
    phase = np.minimum(sigma_range * total, _TAP_NOISE)
    path = np.sqrt(np.maximum(sigma_range**2 - (phase / total) ** 2, 0.0))
    return phase.astype(np.float32), path.astype(np.float32)


@loop()
def expose(
    light, source, amplitude, phase_noise, path_noise, noise_gain, delay, K, normals, jitter, taps
):
    """
    Collect the taps of one frame.

    * `light`: (J, N) complex64 phasors that reach the pixels
    * `source`: (N,) int32, index of the pixel whose light each pixel gets
    * `amplitude`, `phase_noise`, `path_noise`: (N,) float32 of the scene without effects; they
      determine the noise
    * `noise_gain`: (N,) float32 factor on the taps' noise
    * `delay`: (N,) float32 extra path of each pixel, metres
    * `K`: (J,) float64 wavenumbers
    * `normals`: (1 + 4 J, N) float32
    * `jitter`: (N,) float32 output: extra path, metres
    * `taps`: (J, 4, N) float32 output, without ambient light
    """
    frequencies, count = light.shape
    for i in range(count):
        s = source[i]
        jitter[i] = path_noise[s] * normals[0, i] + delay[i]
        usual = np.float32(1.4142135) * amplitude[s] * phase_noise[s] * noise_gain[s]
        for j in range(frequencies):
            re, im = light[j, s].real, light[j, s].imag
            # Half of the variance is read noise, half the shot noise of the light.
            more = math.sqrt(re * re + im * im) / max(amplitude[s], np.float32(1e-12))
            spread = usual * np.float32(math.sqrt(0.5 + 0.5 * more))
            if jitter[i] != 0:
                turn = K[j] * jitter[i]
                c, d = np.float32(math.cos(turn)), np.float32(math.sin(turn))
                re, im = re * c - im * d, re * d + im * c
            n = 1 + 4 * j
            taps[j, 0, i] = re + spread * normals[n, i]
            taps[j, 1, i] = -im + spread * normals[n + 1, i]
            taps[j, 2, i] = -re + spread * normals[n + 2, i]
            taps[j, 3, i] = im + spread * normals[n + 3, i]


def demodulate(taps: np.ndarray) -> np.ndarray:
    """Return the (J, ...) complex64 phasors of (J, 4, ...) taps; ambient light cancels."""
    out = np.empty((taps.shape[0], *taps.shape[2:]), np.complex64)
    out.real = 0.5 * (taps[:, 0] - taps[:, 2])
    out.imag = 0.5 * (taps[:, 3] - taps[:, 1])
    return out


@loop()
def unwrap(phasors, K, reference, disagreement, period, out):
    """
    Turn phases into range.

    With one frequency, the result is the range nearest to ``reference`` among those that the phase
    allows. With two, it is the pair of wraps at which the frequencies agree best, then the mean
    weighted by the squared wavenumber, up to the common period nearest to ``reference``.

    * `phasors`: (J, N) complex64, J = 1 or 2
    * `K`: (J,) float64 wavenumbers, the larger one first
    * `reference`: (N,) float32 metres
    * `disagreement`: (N,) float32, radians, added to the difference of the frequencies for the
      choice of wraps only
    * `period`: the range after which all phases repeat, metres
    * `out`: (N,) float32 metres
    """
    turn = 2 * math.pi
    step = turn / K[0]
    for i in range(len(out)):
        one = math.atan2(phasors[0, i].imag, phasors[0, i].real) / turn
        if len(K) == 1:
            value = one * step
        else:
            two = math.atan2(phasors[1, i].imag, phasors[1, i].real) / turn
            other = turn / K[1]
            value, best = 0.0, math.inf
            for n in range(int(round(period / step))):
                a = (one + n) * step
                m = np.rint((a - (two + disagreement[i] / turn) * other) / other)
                apart = abs(a - (two + disagreement[i] / turn + m) * other)
                if apart < best:
                    best = apart
                    b = (two + m) * other
                    value = (K[0] * K[0] * a + K[1] * K[1] * b) / (K[0] * K[0] + K[1] * K[1])
        out[i] = value + period * np.rint((reference[i] - value) / period)
