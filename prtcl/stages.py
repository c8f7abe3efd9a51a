"""The stages by themselves, for scripts: arrays in, arrays out.

NumPy arrays in give NumPy arrays out. pyopencl arrays in give pyopencl arrays out, on their own queue: the caller's
context and queue are used as they are. The pipeline is::

    bits    = visibility(mesh, levels=5)                 # which directions each vertex sees
    light   = environment(image, frames, levels=5)       # L_n, the environment in each vertex's frame
    reduced = triple(haar(light), visibility_haar(bits, levels=5))     # L ⊕ V, once
    f       = brdf("ggx:alpha=0.3,f0=0.04", views, levels=5)           # f_v, at every edit
    colour  = shade(reduced, f)                          # equation (5)
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import environment as _environment
from prtcl.factors import hemisphere
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials
from prtcl.factors.visibility import Tracer
from prtcl.scene.mesh import Mesh
from prtcl.scene.points import vertex_points
from prtcl.transport import shade as _shade
from prtcl.wavelet import haar as _haar
from prtcl.wavelet import masked as _masked
from prtcl.wavelet import triple as _triple


@lru_cache(maxsize=1)
def default_device() -> Device:
    """The device that is used where none is given: made at the first call, kept for the process."""
    return Device()


@lru_cache(maxsize=8)
def _device_of_queue(queue: Any) -> Device:
    return Device(queue=queue)


def _on_device(device: Device | None, *arrays: Any) -> tuple[Device, bool]:
    """The device for some arrays, and whether results stay on it."""
    queues = [array.queue for array in arrays if hasattr(array, "base_data")]
    if device is None:
        device = _device_of_queue(queues[0]) if queues else default_device()
    return device, bool(queues)


def haar(samples: Any, *, device: Device | None = None) -> Any:
    """Orthonormal 2D Haar coefficients of Morton-ordered samples (`prtcl.quadtree` has the layout).

    Parameters
    ----------
    samples : (..., 4**levels), NumPy (taken as the device's precision) or pyopencl
    device : None takes the array's queue, or the default device

    Returns
    -------
    coefficients : the same shape, by level

    Raises
    ------
    InputError
        If the last axis is not 4**levels with 1 to 9 levels.

    Examples
    --------
    >>> haar([[1.0, 2.0, 3.0, 4.0]])  # doctest: +SKIP
    array([[ 5., -1., -2.,  0.]], dtype=float32)
    """
    device, stay = _on_device(device, samples)
    out = _haar.forward(device, device.array(samples, name="samples"))
    return out if stay else out.get()


def ihaar(coefficients: Any, *, device: Device | None = None) -> Any:
    """Inverse of `haar`."""
    device, stay = _on_device(device, coefficients)
    out = _haar.inverse(device, device.array(coefficients, name="coefficients"))
    return out if stay else out.get()


def triple(a: Any, b: Any, *, keep: int | None = None, device: Device | None = None) -> Any:
    """Reduced coefficients a ⊕ b: the Haar coefficients of the product of two functions.

    Parameters
    ----------
    a : (n, channels, 4**levels) coefficients
    b : (n, channels or 1, 4**levels)
    keep : levels of the product to keep; None is all. What is kept is exact.

    Returns
    -------
    reduced : (n, channels, 4**keep)

    Notes
    -----
    (a ⊕ b)_j = 2^(r−R)(a_j+ b_j− + a_j− b_j+) + a_j psum(b) + b_j psum(a) + G_j; Sitthi-Amorn et al.,
    supplemental, with G_j corrected (kernels/triple.cl).
    """
    device, stay = _on_device(device, a, b)
    out = _triple.reduce(device, device.array(a, name="a"), device.array(b, name="b"), keep=keep)
    return out if stay else out.get()


def visibility(mesh: Mesh, *, levels: int = 5, frames: Any = None, positions: Any = None) -> Any:
    """Visibility bits of a mesh's vertices, or of points given by position and frame.

    Parameters
    ----------
    mesh : what occludes
    levels : 4**levels rays a point
    frames, positions : (n, 3, 3) and (n, 3) world, for points other than the vertices

    Returns
    -------
    bits : (n, words) uint32: sample s (Morton order) is bit s % 32 of word s // 32; 1 is visible
    """
    if not 1 <= levels <= quadtree.MAX_LEVELS:
        raise InputError(f"levels: expected 1 to {quadtree.MAX_LEVELS}, got {levels}")
    if (frames is None) != (positions is None):
        raise InputError("visibility: expected both positions and frames, or neither")
    tracer = Tracer(mesh.vertices, mesh.faces)
    if frames is None:
        points = vertex_points(mesh, tracer)
        return tracer.visibility(points.origins, points.frames, levels)
    axes = np.asarray(frames, dtype=np.float32).reshape(-1, 3, 3)
    return tracer.visibility(tracer.origins(np.asarray(positions), axes[:, 2]), axes, levels)


def visibility_haar(bits: Any, *, levels: int, device: Device | None = None) -> Any:
    """Exact Haar coefficients of visibility bits: (n, words) uint32 to (n, 1, 4**levels)."""
    device, stay = _on_device(device, bits)
    if bits.shape[-1] != quadtree.visibility_words(levels):
        raise InputError(
            f"bits: expected (n, {quadtree.visibility_words(levels)}) for {levels} levels, got {tuple(bits.shape)}"
        )
    out = _masked.visibility_coefficients(device, bits, levels)
    return out if stay else out.get()


def environment(
    image: _environment.Environment | npt.ArrayLike, frames: Any, *, levels: int, device: Device | None = None
) -> Any:
    """L_n: an environment's radiance over each frame's hemisphere, every bit of its energy in the grid.

    Parameters
    ----------
    image : an `Environment`, or (h, 2 h, 3) radiance
    frames : (n, 3, 3) world tangent, bitangent, normal; or (n, 3) unit normals
    levels : of the hemisphere grid

    Returns
    -------
    samples : (n, 3, 4**levels) radiance, Morton order; `haar` makes coefficients of them
    """
    if not isinstance(image, _environment.Environment):
        image = _environment.Environment(np.asarray(image, dtype=np.float32))
    device, stay = _on_device(device, frames)
    host = frames.get() if stay else np.asarray(frames)
    axes = hemisphere.frames_from(host) if host.ndim == 2 else host
    out = _environment.gather(device, image.split(levels), axes, splat_hard=True)
    return out if stay else out.get()


def brdf(material: str | Material, views: npt.ArrayLike, *, levels: int, device: Device | None = None) -> Any:
    """f_v: Haar coefficients of reflectance times cosine for local view directions (n, 3).

    Returns
    -------
    coefficients : (n, channels, 4**levels), one channel where the material is grey
    """
    device = device or default_device()
    packed = Materials(device, [Material.parse(material)])
    return packed.slices(views, levels).get()[0]


def shade(
    reduced: Any, slices: Any, index: Any = None, weight: Any = None, *, device: Device | None = None
) -> Any:
    """Radiance I_p = (2π/4**levels) Σ_j (L ⊕ V)_j f_v,j, equation (5).

    Parameters
    ----------
    reduced : (n, channels, 4**levels) as `triple` returns them with all levels kept
    slices : (m, 1 or channels, 4**levels) as `brdf` returns them
    index : (n, k) int32, the slices of each point; None takes slice i for point i, or the only one for all
    weight : (n, k), their weights; None weighs k equally

    Returns
    -------
    radiance : (n, 3)
    """
    device, stay = _on_device(device, reduced, slices)
    coefficients, f = device.array(reduced, name="reduced"), device.array(slices, name="slices")
    if len(coefficients.shape) != 3 or len(f.shape) != 3 or coefficients.shape[-1] != f.shape[-1]:
        raise InputError(
            "shade: expected reduced (n, channels, 4**levels) and slices (m, channels, 4**levels) of the same levels, "
            f"got {tuple(coefficients.shape)} and {tuple(f.shape)}"
        )
    count = coefficients.shape[0]
    if index is None:
        if f.shape[0] not in (1, count):
            raise InputError(
                f"index: needed to tell which of {f.shape[0]} slices each of {count} points takes"
            )
        index = (np.zeros(count) if f.shape[0] == 1 else np.arange(count)).reshape(-1, 1)
    if weight is None:
        weight = np.full(index.shape, 1.0 / index.shape[1])
    levels = quadtree.levels_of(f.shape[-1])
    out = _shade.soft_radiance(device, coefficients, f, index, weight, levels)
    return out if stay else out.get()[:, :3]
