"""Writes .bsdf files: tables of the adaptive parameterisation made from GGX, or any fields a test wants."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

TYPES = {"u1": 1, "i1": 2, "u2": 3, "i2": 4, "u4": 5, "i4": 6, "u8": 7, "i8": 8, "f2": 9, "f4": 10, "f8": 11}


def write_tensors(path: Path, fields: dict[str, NDArray[Any]]) -> None:
    """The container, as prtcl.files.tensor_file describes it."""
    index, at = b"", 18 + sum(13 + len(key) + 8 * np.ndim(value) for key, value in fields.items())
    for key, value in fields.items():
        at += -at % 8
        index += (
            struct.pack("<H", len(key))
            + key.encode()
            + struct.pack("<HBQ", value.ndim, TYPES[value.dtype.str[1:]], at)
        )
        index += struct.pack(f"<{value.ndim}Q", *value.shape)
        at += value.nbytes
    out = b"tensor_file\0" + bytes([1, 0]) + struct.pack("<I", len(fields)) + index
    for value in fields.values():
        out += b"\0" * (-len(out) % 8) + value.tobytes()
    path.write_bytes(out)


def ggx_fields(
    alpha: float = 0.3, side: int = 16, channels: int = 3, phis: int = 1, seed: int = 1
) -> dict[str, NDArray[Any]]:
    """Fields of a GGX-like material; colours are random about what GGX has, so that every table matters."""
    rng = np.random.default_rng(seed)
    theta_i = np.linspace(0.0, 1.5, 5)
    u = np.linspace(0.0, 1.0, 33)
    theta, phi = u**2 * np.pi / 2, (2 * np.linspace(0.0, 1.0, 24) - 1) * np.pi
    distribution = alpha**2 / (np.pi * (np.cos(theta) ** 2 * (alpha**2 - 1) + 1) ** 2)
    ndf = np.broadcast_to(distribution, (phi.size, u.size))
    cosine = np.cos(theta)
    sigma = np.broadcast_to((cosine + np.sqrt(cosine**2 + alpha**2 * (1 - cosine**2))) / 2, (2, u.size))
    vndf = np.empty((phis, theta_i.size, phi.size, u.size))
    for t, angle in enumerate(theta_i):
        facing = np.sin(angle) * np.sin(theta) * np.cos(phi)[:, None] + np.cos(angle) * np.cos(theta)
        # Densities over the square have its Jacobian, u sin θ; a little is added so that no row is empty.
        vndf[:, t] = np.maximum(facing, 0) * distribution * u * np.sin(theta) + 1e-3
    colours = rng.uniform(0.2, 1.0, (phis, theta_i.size, channels, side, side))
    luminance = colours.mean(axis=2)
    fields = {
        "description": np.frombuffer(b"made", np.uint8),
        "theta_i": theta_i, "phi_i": np.linspace(0.0, 1.0, phis), "ndf": ndf, "sigma": sigma, "vndf": vndf,
        "luminance": luminance, "jacobian": np.array([1], np.uint8),
        "rgb" if channels == 3 else "spectra": colours,
    }  # fmt: skip
    if channels != 3:
        fields["wavelengths"] = np.linspace(360.0, 760.0, channels)
    return {k: np.ascontiguousarray(v if v.dtype == np.uint8 else v.astype("<f4")) for k, v in fields.items()}
