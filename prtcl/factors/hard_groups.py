"""Hard light in groups of neighbours that a pixel most often sees all of, or none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl.factors.environment import Light

Array = npt.NDArray[np.float64]

PROBES = 8
"""Rays of a group that are traced in any case: its outermost samples in so many directions around it."""
EXTENT = 0.035
"""Chord (two degrees) up to which neighbours are one group: a sun and its glow."""
PAIRS = 128
"""A group of all of a map's energy becomes so many samples, one with a quarter of it half as many: each is a pair of a
direction and a sub-pixel point, and a glint varies over both (bench/relight_choices.py). Four times as many would halve
the error where the edge of a hard sun's shadow passes (bench/flicker.py), for more than twice the rays."""
STRONG = 0.005
"""Share of the energy below which a group keeps the samples it has, and is seen where its cell of the soft light's
grid is: no ray is spent on it. Its reflection is still that of its own direction (bench/relight_choices.py)."""


@dataclass(frozen=True, eq=False)
class HardGroups:
    """Hard samples of one environment, ordered by groups.

    Attributes
    ----------
    samples : (k, 6) float64: world direction; irradiance at normal incidence, RGB
    begin : (g + 1,) int32: where each group begins
    traced : (g,) bool: which groups deserve rays
    probes : (g, PROBES, 3) float64: each group's outermost world directions, once around it
    outwards : (g, PROBES, 3) float64: unit, across the group's mean direction: where each of them is the outermost
    """

    samples: Array
    begin: npt.NDArray[np.int32]
    traced: npt.NDArray[np.bool_]
    probes: Array
    outwards: Array

    @classmethod
    def of(cls, light: Light) -> HardGroups:
        """Groups of an environment's hard samples; energy is kept."""
        hard = light.hard
        total = hard[:, 3:].sum() / light.hard_share if light.hard_share > 0 else np.inf
        # Apart on the map's own axes, so that a turned environment has the same groups.
        own = hard[:, :3] @ light.to_map.T
        parts = _apart(own, np.arange(len(hard)))
        samples, begin, traced = [np.zeros((0, 6))], [0], []
        outermost = np.zeros((2, len(parts), PROBES, 3))
        for number, part in enumerate(parts):
            held = hard[part, 3:].sum() / total
            copies = -(-max(PROBES, int(PAIRS * held**0.5)) // len(part)) if held > STRONG else 1
            # Copies meet other points: positions are turns.
            group = hard[np.repeat(part, copies)]
            group[:, 3:] /= copies
            samples.append(group)
            begin.append(begin[-1] + len(group))
            traced.append(held > STRONG)
            outermost[:, number] = _outermost(own[part])
        probes, outwards = outermost @ light.to_map
        return cls(
            np.concatenate(samples), np.array(begin, np.int32), np.array(traced, np.bool_), probes, outwards
        )


def _outermost(directions: Array) -> tuple[Array, Array]:
    """Of directions near one another the outermost ones, `PROBES` times around, and which way each is: (PROBES, 3)."""
    middle = directions.mean(axis=0)
    least = np.eye(3)[np.argmin(np.abs(middle))]
    first = np.cross(middle, least)
    first /= np.linalg.norm(first)
    second = np.cross(middle / np.linalg.norm(middle), first)
    angle = 2 * np.pi * np.arange(PROBES)[:, None] / PROBES
    outwards = np.cos(angle) * first + np.sin(angle) * second
    return directions[np.argmax(outwards @ directions.T, axis=1)], outwards


def _apart(directions: Array, members: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
    """Members cut at the widest gap along their longest axis until each part is within `EXTENT`."""
    if not len(members):
        return []
    own = directions[members]
    axis = int(np.argmax(np.ptp(own, axis=0)))
    if np.ptp(own[:, axis]) <= EXTENT or len(members) == 1:
        return [members]
    members = members[np.argsort(own[:, axis], kind="stable")]
    cut = int(np.argmax(np.diff(directions[members, axis]))) + 1
    return _apart(directions, members[:cut]) + _apart(directions, members[cut:])
