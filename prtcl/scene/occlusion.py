"""What visibility bits say by themselves: ambient occlusion, bent normals, and the bits as pictures."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.factors import hemisphere

BYTES = 1 << 27
"""Of unpacked samples at a time, as float64."""


def unpack(bits: npt.NDArray[np.uint32], rays: int) -> npt.NDArray[np.uint8]:
    """Visibility of each sample.

    Parameters
    ----------
    bits : (n, words) uint32, as `Tracer.visibility` gives them
    rays : levels of the grid

    Returns
    -------
    (n, 4**rays) uint8, Morton order, 1 is visible
    """
    octets = np.ascontiguousarray(bits, dtype="<u4").view(np.uint8)
    return np.unpackbits(octets, axis=1, count=quadtree.n_samples(rays), bitorder="little")


def sums(bits: npt.NDArray[np.uint32], rays: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Ambient occlusion, and the cosine-weighted sum of what is visible, in local frames.

    With N = 4**rays cells of solid angle 2π / N, cell s of mean cosine c_s and centre ω_s, and visibility V_s:

        AO = (1/π) ∫ V(ω) cos θ dω = Σ_s V_s c_s / Σ_s c_s,          b = Σ_s V_s c_s ω_s / Σ_s c_s.

    The mean cosines are exact, Σ_s c_s = N / 2, so that AO is exact for a surface that cuts no cell in two: 1 where
    nothing hides the sky, 0 where everything does. c_s are those that rendering uses (float32).

    Parameters
    ----------
    bits : (n, words) uint32
    rays : levels of the grid

    Returns
    -------
    ambient : (n,) float64, 0 to 1
    bent : (n, 3) float64, local (tangent, bitangent, normal); not normalised
    """
    table = hemisphere.directions(rays).astype(np.float64)
    total = table[:, 3].sum()
    # One product for both: the columns are c and c ω.
    weights = np.concatenate([np.ones((len(table), 1)), table[:, :3]], axis=1) * (table[:, 3:] / total)
    out = np.empty((len(bits), 4))
    step = max(1, BYTES // (8 * len(table)))
    for start in range(0, len(bits), step):
        part = slice(start, start + step)
        out[part] = unpack(bits[part], rays).astype(np.float64) @ weights
    return np.minimum(out[:, 0], 1.0), out[:, 1:]


def ambient_occlusion(bits: npt.NDArray[np.uint32], rays: int) -> npt.NDArray[np.float32]:
    """Cosine-weighted mean visibility of each vertex: (n,) float32, 1 is open; see `sums`."""
    return sums(bits, rays)[0].astype(np.float32)


def ambient_and_bent(
    bits: npt.NDArray[np.uint32], rays: int, normals: npt.NDArray[np.floating]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Ambient occlusion, and the direction that light comes from on average under a constant sky.

    The convention of bent normals is the cosine-weighted one: b of `sums`, in world coordinates, normalised. (Another,
    the plain mean of the visible directions after Landis 2002, "Production-Ready Global Illumination", leans further
    to the horizon.)

    Parameters
    ----------
    bits : (n, words) uint32
    rays : levels of the grid
    normals : (n, 3) unit, world, which the bits were traced with

    Returns
    -------
    ambient : (n,) float32
    bent : (n, 3) float32, unit; zeros where nothing is visible
    """
    ambient, local = sums(bits, rays)
    frames = hemisphere.frames_from(normals).astype(np.float64)
    world = np.einsum("ni,nij->nj", local, frames)
    length = np.linalg.norm(world, axis=1, keepdims=True)
    # Each cell has z > 0, so that only a vertex that sees nothing has length 0.
    bent = np.where(length > 0.0, world / np.where(length > 0.0, length, 1.0), 0.0)
    return ambient.astype(np.float32), bent.astype(np.float32)


def visibility_maps(bits: npt.NDArray[np.uint32], rays: int) -> npt.NDArray[np.uint8]:
    """Visibility as pictures over the concentric square.

    Returns
    -------
    (n, side, side) uint8, 1 is visible: row and column as `hemisphere.from_square` has them, the normal in the
    middle, the horizon along the border, the tangent to the right
    """
    return unpack(bits, rays)[:, quadtree.grid_to_morton(rays)]
