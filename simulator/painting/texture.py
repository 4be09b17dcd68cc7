"""Seeded textures that tile: what asphalt, plaster and clouds are painted with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]


def fractal_noise(seed: int, size: int, slope: float) -> FloatArray:
    """(size, size) periodic noise of zero mean and unit standard deviation; amplitude falls as wave number^-slope."""
    waves = np.hypot(fft.fftfreq(size)[:, None], fft.rfftfreq(size)[None, :]) * size
    waves[0, 0] = np.inf
    white = fft.rfft2(np.random.default_rng(seed).standard_normal((size, size)))
    # One more power: each octave of a plane holds as many waves as its wave number.
    noise = fft.irfft2(white * waves ** -(slope + 1.0) if slope else white * np.isfinite(waves), s=(size, size))
    return np.asarray((noise - noise.mean()) / noise.std())


class Texture:
    """A periodic texture that is read at positions in metres."""

    def __init__(self, values: FloatArray, step_m: float) -> None:
        self._values = values.astype(np.float32)
        self._step_m = step_m

    def at(self, u_m: Float32Array, v_m: Float32Array) -> Float32Array:
        """Nearest texel."""
        size = len(self._values)
        u = np.floor(u_m * np.float32(1 / self._step_m)).astype(np.int32) % size
        v = np.floor(v_m * np.float32(1 / self._step_m)).astype(np.int32) % size
        return np.asarray(self._values[v, u])

    def smooth(self, u_m: Float32Array, v_m: Float32Array) -> Float32Array:
        """Bilinear between texels: for texels larger than a pixel."""
        u, v = u_m * np.float32(1 / self._step_m), v_m * np.float32(1 / self._step_m)
        u0, v0 = np.floor(u), np.floor(v)
        fu, fv = u - u0, v - v0
        size = len(self._values)
        i, j = u0.astype(np.int32) % size, v0.astype(np.int32) % size
        i1, j1 = (i + 1) % size, (j + 1) % size
        low = self._values[j, i] * (1 - fu) + self._values[j, i1] * fu
        high = self._values[j1, i] * (1 - fu) + self._values[j1, i1] * fu
        return np.asarray(low * (1 - fv) + high * fv)
