"""Reduced coefficients a ⊕ V where V is visibility, given by its bits: dense, and in place where V is mostly uniform.

All take rows of every channel of a point, (points, channels, 4**levels), and give the same coefficients as
`prtcl.wavelet.triple.reduce` does with the transform of V.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.errors import InputError
from prtcl.wavelet import haar, triple

GROUP = 64
DENSE = Tunable("masked", (Form("stages"), Form("wide")), cpu=Form("wide"), gpu=Form("stages"))
"""One launch a stage, or all of them in one pass over vectors (reduce_wide.cl)."""
SPARSE = Tunable(
    "sparse",
    (Form("points", 1), Form("points", 8), Form("points", 64)),
    cpu=Form("points", 1),
    gpu=Form("points", 64),
)
"""Work-items a group, one a point (reduce_sparse.cl)."""


def visibility_coefficients(device: Device, bits: Any, rays: int, levels: int | None = None) -> Any:
    """Haar coefficients of visibility, exact integer sums by popcount.

    Parameters
    ----------
    bits : (n, words) uint32, host or device, of 4**rays directions
    levels : of the coefficients, at least `rays` (the default)

    Returns
    -------
    coefficients : device array (n, 1, 4**levels)
    """
    levels = rays if levels is None else levels
    words = device.array(bits, np.uint32, name="bits")
    count = words.shape[0]
    top = max(0, rays - 3)
    out = device.empty((count, 1, quadtree.n_samples(levels)))
    means = device.empty((max(1, count << (2 * top)),))
    kernel = device.kernels("visibility.cl", LEVELS=levels, BITS=rays, GROUP=GROUP)["visibility_coefficients"]
    device.launch(kernel, count << (2 * top), GROUP, words, out, means, count)
    if top:
        haar.forward_from_means(device, means, top, out)
    return out


def reduce_samples(device: Device, samples: Any, bits: Any, rays: int, keep: int) -> Any:
    """a ⊕ V from the samples of a: the pixel domain's form of the product.

    Parameters
    ----------
    samples : device array (n, channels, 4**levels), Morton order
    bits : (n, words) uint32 visibility of 4**rays directions, rays ≤ levels
    keep : levels of the product to keep

    Returns
    -------
    reduced : device array (n, channels, 4**keep) of Haar coefficients
    """
    levels, words = _checked(device, samples, bits, rays, "samples")
    count, channels, _ = samples.shape
    out = device.empty((count, channels, quadtree.n_samples(keep)))
    if DENSE.of(device).name == "wide" and triple.wide_fits(levels):
        kernel = _wide(device, levels, rays, keep, channels)["reduce_samples"]
        device.launch(kernel, count, 1, samples, words, out, count)
        return out
    kernel = device.kernels(
        "product.cl", LEVELS=levels, BITS=rays, KEEP=keep, CHANNELS=channels, GROUP=GROUP
    )["masked_average"]
    product = device.empty(out.shape)
    device.launch(kernel, quadtree.n_samples(keep), GROUP, samples, words, product, y=count * channels)
    return haar.forward(device, product, out=out, scale=2.0 ** (levels - keep))


def reduce_coefficients(device: Device, coefficients: Any, bits: Any, rays: int, keep: int) -> Any:
    """a ⊕ V from the coefficients of a, every square of the tree.

    Parameters
    ----------
    coefficients : device array (n, channels, 4**levels)
    bits, keep, and what is returned : as for `reduce_samples`
    """
    levels, words = _checked(device, coefficients, bits, rays, "coefficients")
    count, channels, _ = coefficients.shape
    if DENSE.of(device).name == "wide" and triple.wide_fits(levels):
        out = device.empty((count, channels, quadtree.n_samples(keep)))
        kernel = _wide(device, levels, rays, keep, channels)["reduce_bits"]
        device.launch(kernel, count, 1, coefficients, words, out, count)
        return out
    return triple.reduce(
        device, coefficients, visibility_coefficients(device, words, rays, levels), keep=keep
    )


def reduce_in_place(device: Device, coefficients: Any, bits: Any) -> Any:
    """a ⊕ V written over the coefficients of a, at the cost of the squares in which V changes.

    Parameters
    ----------
    coefficients : device array (n, channels, 4**levels), overwritten
    bits : (n, words) uint32 visibility of 4**levels directions: a grid as fine as the coefficients

    Returns
    -------
    coefficients : the same array
    """
    levels = quadtree.levels_of(coefficients.shape[-1])
    levels, words = _checked(device, coefficients, bits, levels, "coefficients")
    count, channels, _ = coefficients.shape
    group = SPARSE.of(device).size
    kernel = device.kernels("reduce_sparse.cl", LEVELS=levels, CHANNELS=channels, GROUP=group)[
        "reduce_sparse"
    ]
    device.launch(kernel, count, group, coefficients, words, count)
    return coefficients


def _wide(device: Device, levels: int, rays: int, keep: int, channels: int) -> dict[str, Any]:
    return device.kernels(
        "reduce_wide.cl", LEVELS=levels, BITS=rays, KEEP=keep, CHANNELS=channels, CHANNELS_B=1
    )


def _checked(device: Device, rows: Any, bits: Any, rays: int, name: str) -> tuple[int, Any]:
    """Levels of the rows, and the bits on the device.

    Raises
    ------
    InputError
        If shapes do not fit together.
    """
    _, levels = haar.check_rows(rows, name)
    words = device.array(bits, np.uint32, name="bits")
    expected = (rows.shape[0], quadtree.visibility_words(rays))
    if len(rows.shape) != 3 or words.shape != expected or rays > levels:
        raise InputError(
            f"{name} and bits: expected (points, channels, 4**levels) and {expected} words of visibility at "
            f"4**{rays} directions, got {tuple(rows.shape)} and {tuple(words.shape)}"
        )
    return levels, words
