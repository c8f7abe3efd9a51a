"""Materials as the viewer's page shows them: a kind and a few sliders, presets, and a history to go back in."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from prtcl.apps.view.recipe import Recipe
from prtcl.factors.material import Material

Colour = tuple[float, float, float]

KINDS = ("lambert", "metal", "dielectric", "blinn", "table", "as given")
ALPHA = (0.02, 1.0)
"""Range of the roughness slider. Sharper lobes are for `prtcl render`: vertices are too far apart for them."""
HISTORY = 500
MERGE = 1.0
"""Seconds: changes by one control that follow each other within them are one step of the history."""


_COLOUR_OF = {"lambert": "albedo", "ggx-schlick": "kd", "blinn": "kd"}


@dataclass(frozen=True)
class Look:
    """One part's material.

    Attributes
    ----------
    kind : one of `KINDS`
    colour : linear; albedo, reflectance at normal incidence of a metal, or what lies under a coat
    alpha : GGX roughness; Blinn's exponent is the one that corresponds to it
    specular : reflectance at normal incidence of a dielectric, ks of blinn
    painted : the mesh's own colour multiplies this one
    recipe : what a table is made of and how it is edited; kept while another kind is tried
    given : what "as given" means: the material of the command line or of the mesh
    """

    kind: str = "lambert"
    colour: Colour = (0.5, 0.5, 0.5)
    alpha: float = 0.3
    specular: float = 0.04
    given: Material | None = None
    painted: bool = False
    recipe: Recipe | None = None

    @classmethod
    def of(cls, material: Material) -> Look:
        """A look that shows this material, on sliders where they reach it, to the four digits of a SPEC."""
        numbers = material.numbers
        at = cls("as given", given=material)
        if material.kind == "table":
            return replace(at, kind="table", recipe=Recipe(material))
        if material.tints:
            parameter, painted = _COLOUR_OF.get(material.kind, ""), replace(at, painted=True)
            if material.tints != {parameter: (1.0, 1.0, 1.0)}:
                return painted  # such as glTF's, whose metals are tinted twice
            look = cls.of(replace(material, tints={}))
            return replace(look, painted=True, given=material) if look.kind != "metal" else painted
        if material.kind == "lambert":
            return replace(at, kind="lambert", colour=numbers["albedo"])
        if material.kind == "ggx-conductor":
            # Its colour at normal incidence, for who moves on from it.
            return replace(at, colour=_normal_reflectance(numbers), alpha=_clamped(numbers["alpha"], *ALPHA))
        if material.kind not in ("ggx-schlick", "blinn"):
            return at
        strength = numbers["f0" if material.kind == "ggx-schlick" else "ks"]
        alpha, based, grey = material.roughness, any(numbers["kd"]), len(set(strength)) == 1
        at = replace(
            at, colour=numbers["kd"], alpha=_clamped(alpha, *ALPHA), specular=float(np.mean(strength))
        )
        if not ALPHA[0] <= alpha <= ALPHA[1]:
            return at
        if material.kind == "blinn":
            return replace(at, kind="blinn") if grey and numbers["exponent"] > 0 else at
        if not based and not (grey and strength[0] <= 0.2):
            return replace(at, kind="metal", colour=strength, specular=0.04)
        return replace(at, kind="dielectric") if grey else at

    def cleaned(self) -> Look:
        """With every value in its range: what comes from a page is only a wish."""
        kind = self.kind if self.kind in KINDS else "lambert"
        if (kind == "as given" and self.given is None) or (kind == "table" and self.recipe is None):
            kind = "lambert"
        colour = [_clamped(value, 0.0, 1.0) for value in self.colour]
        return replace(
            self,
            kind=kind,
            colour=(colour[0], colour[1], colour[2]),
            alpha=_clamped(self.alpha, *ALPHA),
            specular=_clamped(self.specular, 0.0, 1.0),
        )

    def tabulated(self) -> Look:
        """The same as a table to edit; the edits made before, where it was one of this material."""
        if self.kind == "table":
            return self
        base = self.material
        recipe = self.recipe if self.recipe is not None and self.recipe.base is base else Recipe(base)
        return replace(self, kind="table", recipe=recipe)

    @property
    def spec(self) -> str:
        """The SPEC that `--brdf` takes; of a table what it was made of."""
        colour = "/".join(f"{value:.4g}" for value in self.colour) + ("*mesh" if self.painted else "")
        if self.kind == "as given" and self.given is not None:
            return self.given.spec
        if self.kind == "table" and self.recipe is not None:
            return self.recipe.spec
        if self.kind == "metal":
            return f"ggx:alpha={self.alpha:.4g},f0={colour}"
        if self.kind == "dielectric":
            return f"ggx:alpha={self.alpha:.4g},f0={self.specular:.4g},kd={colour}"
        if self.kind == "blinn":
            # Walter et al. 2007, section 5: α = √(2/(n + 2)).
            return f"blinn:exponent={max(0.0, 2 / self.alpha**2 - 2):.4g},ks={self.specular:.4g},kd={colour}"
        return f"lambert:albedo={colour}"

    @property
    def material(self) -> Material:
        """What is rendered; the same object for the same look."""
        if self.kind == "as given" and self.given is not None:
            return self.given
        if self.kind == "table" and self.recipe is not None:
            return self.recipe.material
        return _parsed(self.spec)


PRESETS = {
    "plaster": Look("lambert", (0.75, 0.72, 0.68)),
    "terracotta": Look("lambert", (0.5, 0.22, 0.12)),
    "gold": Look("metal", (1.0, 0.78, 0.34), alpha=0.2),
    "polished gold": Look("metal", (1.0, 0.78, 0.34), alpha=0.06),
    "copper": Look("metal", (0.95, 0.64, 0.54), alpha=0.2),
    "chrome": Look("metal", (0.55, 0.56, 0.57), alpha=0.05),
    "satin aluminium": Look("metal", (0.91, 0.92, 0.92), alpha=0.35),
    "green glaze": Look("dielectric", (0.05, 0.25, 0.12), alpha=0.06, specular=0.05),
    "red plastic": Look("dielectric", (0.5, 0.03, 0.03), alpha=0.15),
    "satin paint": Look("dielectric", (0.08, 0.18, 0.42), alpha=0.35),
    "rubber": Look("dielectric", (0.03, 0.03, 0.03), alpha=0.6, specular=0.03),
    "lacquer (blinn)": Look("blinn", (0.3, 0.02, 0.02), alpha=0.1, specular=0.3),
}


@dataclass
class History:
    """Looks of all parts, and those before and after."""

    past: list[tuple[Look, ...]] = field(default_factory=list)
    future: list[tuple[Look, ...]] = field(default_factory=list)
    _last: tuple[Any, float] = (None, -math.inf)

    def record(self, before: tuple[Look, ...], control: Any, now: float) -> None:
        """Keep what was `before` a change by a control, unless the same control changed it a moment ago."""
        merged = self._last[0] == control and now - self._last[1] <= MERGE
        self._last = (control, now)
        if not merged:
            self.past.append(before)
            del self.past[:-HISTORY]
        self.future.clear()

    def undo(self, current: tuple[Look, ...]) -> tuple[Look, ...]:
        """What was before; the current looks where nothing was."""
        return self._step(self.past, self.future, current)

    def redo(self, current: tuple[Look, ...]) -> tuple[Look, ...]:
        """What was undone; the current looks where nothing was."""
        return self._step(self.future, self.past, current)

    def _step(
        self, source: list[tuple[Look, ...]], target: list[tuple[Look, ...]], current: tuple[Look, ...]
    ) -> tuple[Look, ...]:
        self._last = (None, -math.inf)
        if not source:
            return current
        target.append(current)
        return source.pop()


@lru_cache(maxsize=256)
def _parsed(spec: str) -> Material:
    return Material.parse(spec)


def _normal_reflectance(numbers: dict[str, Any]) -> Colour:
    """Of a conductor: ((η − 1)² + k²) / ((η + 1)² + k²)."""
    eta, k = (np.asarray(numbers[name], dtype=np.float64) for name in ("eta", "k"))
    found = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
    return float(found[0]), float(found[1]), float(found[2])


def _clamped(value: float, low: float, high: float) -> float:
    """`value` in its range; its lower end for what is no number."""
    return min(high, max(low, float(value))) if math.isfinite(value) else low
