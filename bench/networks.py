"""The measured BRDFs of shared/data/brdfs: networks fitted to them, evaluated anywhere and in MERL's layout.

Sztrajman et al. 2021, "Neural BRDF": three dense layers on the half and the difference vector. The README beside
the weights gives the order and the formula; the fits are reciprocal to a few percent, so the mean of both orders is
taken. The package itself reads measurements and no networks.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import scenes

from prtcl.factors.measured import Measured

Array = npt.NDArray[np.float64]
FOLDER = scenes.DATA / "brdfs"
SOURCES = ("merl", "rgl")
SIZES = ((6, 21), (21,), (21, 21), (21,), (21, 3), (3,))
"""W1, b1, W2, b2, W3, b3, one after another."""


def names(source: str) -> list[str]:
    """Materials of one of `SOURCES`."""
    with np.load(FOLDER / f"{source}_nbrdf.npz") as file:
        return sorted(file.files)


def load(source: str, name: str) -> Callable[[Array, Array], Array]:
    """f of incident and outgoing unit directions (n, 3), above the horizon: (n, 3), 1/sr, in one order."""
    with np.load(FOLDER / f"{source}_nbrdf.npz") as file:
        numbers = np.asarray(file[name], np.float64)
    parts, at = [], 0
    for shape in SIZES:
        size = int(np.prod(shape))
        parts.append(numbers[at : at + size].reshape(shape))
        at += size
    w1, b1, w2, b2, w3, b3 = parts

    def f(incident: Array, outgoing: Array) -> Array:
        half = incident + outgoing
        half = half / np.linalg.norm(half, axis=1, keepdims=True)
        sine = np.hypot(half[:, 0], half[:, 1])
        turn, tilt = np.arctan2(half[:, 1], half[:, 0]), np.arctan2(sine, half[:, 2])
        # The difference vector: i turned by −φ_h about z, then by −θ_h about y.
        x = incident[:, 0] * np.cos(turn) + incident[:, 1] * np.sin(turn)
        y = incident[:, 1] * np.cos(turn) - incident[:, 0] * np.sin(turn)
        z = incident[:, 2]
        d = np.stack([x * np.cos(tilt) - z * np.sin(tilt), y, x * np.sin(tilt) + z * np.cos(tilt)], axis=1)
        given = np.concatenate(
            [np.sin(tilt)[:, None], np.zeros((len(x), 1)), np.cos(tilt)[:, None], d], axis=1
        )
        hidden = np.maximum(given @ w1 + b1, 0)
        hidden = np.maximum(hidden @ w2 + b2, 0)
        return np.asarray(np.maximum(np.exp(hidden @ w3 + b3) - 1, 0))

    return f


def measured(source: str, name: str) -> Measured:
    """A material in MERL's layout, reciprocal; nodes below the horizon are invalid, as measurements have them."""
    return Measured.sample(load(source, name), name=name)
