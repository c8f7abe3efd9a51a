"""A table as the viewer's page edits it: what it is made of, and one number for each control; the table follows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.factors.table import Table

Colour = tuple[float, float, float]
Range = tuple[float, float]

RANGES: dict[str, Range] = {
    "sharpen": (-2.0, 2.0),
    "balance": (-1.0, 1.0),
    "fresnel": (0.0, 3.0),
    "strength": (0.0, 3.0),
    "blend": (0.0, 1.0),
    "paint": (-6.0, 6.0),
}
"""What the sliders reach, and with them what a page may ask for."""
ANGLES: Range = (0.0, 90.0)


@dataclass(frozen=True)
class Recipe:
    """Edits of one material, in the order in which they are done: the same numbers, the same table.

    Attributes
    ----------
    base : what is edited; tabulated where it is no table
    other, blend : a second material, and its share
    sharpen : log2 of the lobe's sharpness
    balance : of the diffuse energy moved to the specular part, or (below 0) back
    fresnel : strength of the rise at grazing angles, 1 as it is
    theta_h, theta_d : degrees, the region that is painted
    paint : stops, by which the region is brighter
    tint, strength : linear, what all is multiplied by
    conserve : scale down what reflects more than it receives
    """

    base: Material
    other: Material | None = None
    blend: float = 0.0
    sharpen: float = 0.0
    balance: float = 0.0
    fresnel: float = 1.0
    theta_h: Range = (0.0, 5.0)
    theta_d: Range = ANGLES
    paint: float = 0.0
    tint: Colour = (1.0, 1.0, 1.0)
    strength: float = 1.0
    conserve: bool = False

    def cleaned(self) -> Recipe:
        """With every number in its range: what comes from a page is only a wish."""
        numbers: dict[str, Any] = {
            name: _clamped(getattr(self, name), *ends) for name, ends in RANGES.items()
        }
        colour = [_clamped(value, 0.0, 1.0) for value in self.tint]
        return replace(
            self, theta_h=_ordered(self.theta_h), theta_d=_ordered(self.theta_d),
            tint=(colour[0], colour[1], colour[2]), conserve=bool(self.conserve), **numbers,
        )  # fmt: skip

    @property
    def spec(self) -> str:
        """For messages: what it was made of."""
        return f"table edited from {self.base.spec}"

    @property
    def table(self) -> Table:
        """What the edits make; the same object for the same recipe.

        Raises
        ------
        InputError
            If the edits leave no finite table.
        """
        return _made(self)

    @property
    def material(self) -> Material:
        """What is rendered; the same object for the same recipe."""
        return _worn(self)


@lru_cache(maxsize=64)
def _made(recipe: Recipe) -> Table:
    table = _tabulated(recipe.base)
    if recipe.other is not None and recipe.blend > 0.0:
        table = table.blended(_tabulated(recipe.other), recipe.blend)
    table = table.sharpened(2.0**recipe.sharpen).balanced(recipe.balance).with_fresnel(recipe.fresnel)
    if recipe.paint != 0.0:
        table = table.painted(recipe.theta_h, recipe.theta_d, factor=2.0**recipe.paint)
    if recipe.tint != (1.0, 1.0, 1.0):
        table = table.tinted(*recipe.tint)
    if recipe.strength != 1.0:
        table = table.scaled(recipe.strength)
    return table.conserved() if recipe.conserve else table


@lru_cache(maxsize=256)
def _worn(recipe: Recipe) -> Material:
    return replace(recipe.table.material(), spec=recipe.spec, like=recipe.base)


@lru_cache(maxsize=16)
def _tabulated(material: Material) -> Table:
    return Table.of(material)


def _clamped(value: float, low: float, high: float) -> float:
    """`value` in its range; what changes least of it for what is no number."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"table: expected a number from {low:g} to {high:g}, got {value!r}")
    return min(high, max(low, float(value)))


def _ordered(ends: Range) -> Range:
    low, high = (_clamped(end, *ANGLES) for end in ends)
    return min(low, high), max(low, high)
