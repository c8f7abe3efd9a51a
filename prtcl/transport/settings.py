"""How finely a job is computed, and what was chosen for it and why."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

from prtcl import quadtree
from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.transport.leave_out import EVERYTHING, WHAT

METHODS = ("auto", "pixel", "tree")
HARD = ("auto", "off")
VISIBILITY = ("adaptive", "every")


@dataclass(frozen=True)
class Settings:
    """Resolutions of the three factors.

    Attributes
    ----------
    levels : light and the product L ⊕ V live on 4**levels directions
    rays : visibility is traced on 4**rays directions, rays ≤ levels
    keep : levels of the product that are kept, and of f_v, keep ≤ levels; the finer ones still enter the
        product (multiply fine, keep coarse)
    views : stored view angles (frames turned to the viewer) or nodes a side (fixed frames)
    method : the product in the "pixel" domain or through the "tree"; "auto" takes the pixel domain, which was
        faster on every device measured (`prtcl bench`), and is the better conditioned one
    hard : "auto" takes hard light out of the map, "off" leaves it in
    visibility : "adaptive" traces rays where neighbours disagree (`prtcl.factors.refine`), "every" traces all
    pixel_error : relative RMSE over the image that adaptive sub-pixel points aim at, by an estimate on the safe
        side (stratified points err less than it assumes)
    hard_error : share of the square of pixel_error that hard light's points may have, 0 to 1
    leave_out : names of `prtcl.transport.leave_out` that are left out where the scene does not need them
    hard_points : points of hard light that an adaptive pixel starts with, 4 or 16; four that all miss a glint say
        nothing of it
    """

    levels: int = 5
    rays: int = 5
    keep: int = 5
    views: int = 128
    method: str = "auto"
    hard: str = "auto"
    visibility: str = "adaptive"
    pixel_error: float = 0.007
    hard_error: float = 0.5
    hard_points: int = 16
    leave_out: frozenset[str] = EVERYTHING

    def __post_init__(self) -> None:
        for name in ("levels", "rays", "keep"):
            value = getattr(self, name)
            if not (_whole(value) and 1 <= value <= quadtree.MAX_LEVELS):
                raise InputError(f"{name}: expected 1 to {quadtree.MAX_LEVELS}, got {value!r}")
        if not (_whole(self.views) and self.views >= 1):
            raise InputError(f"views: expected 1 or more, got {self.views!r}")
        if self.rays > self.levels or self.keep > self.levels:
            raise InputError(
                f"rays and keep: expected at most levels = {self.levels}, got {self.rays} and {self.keep}"
            )
        if self.method not in METHODS:
            raise InputError(f"method: expected one of {', '.join(METHODS)}, got {self.method!r}")
        if self.hard not in HARD:
            raise InputError(f"hard-light: expected one of {', '.join(HARD)}, got {self.hard!r}")
        if not (0.0 <= self.pixel_error < math.inf and 0.0 < self.hard_error < 1.0):
            raise InputError(
                "pixel_error and hard_error: expected 0 or more and between 0 and 1, "
                f"got {self.pixel_error} and {self.hard_error}"
            )
        if not self.leave_out <= EVERYTHING:
            raise InputError(
                f"leave_out: {min(self.leave_out - EVERYTHING)} is none\nthere are: {', '.join(WHAT)}"
            )
        if self.hard_points not in (4, 16):
            raise InputError(f"hard_points: expected 4 or 16, got {self.hard_points}")
        if self.visibility not in VISIBILITY:
            raise InputError(f"visibility: expected one of {', '.join(VISIBILITY)}, got {self.visibility!r}")

    def leaves(self, name: str) -> bool:
        """Whether what has that name is left out where it may be."""
        return name in self.leave_out

    def plain(self) -> dict[str, Any]:
        """All of them as JSON can hold them."""
        return {**vars(self), "leave_out": sorted(self.leave_out)}

    @property
    def tree(self) -> bool:
        """Whether the product goes through the quadtree."""
        return self.method == "tree"

    def with_defaults(self, **given: float | str | frozenset[str] | None) -> Settings:
        """These settings with what a user fixed by hand; None leaves a value as it is.

        A user who gives `levels` alone means the other two as well, as far as they fit.
        """
        fixed = {name: value for name, value in given.items() if value is not None}
        if "levels" in fixed:
            for name in ("rays", "keep"):
                fixed.setdefault(name, min(getattr(self, name), int(fixed["levels"])))  # type: ignore[arg-type]
        return replace(self, **fixed)  # type: ignore[arg-type]


def _whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def settle(
    material: Material,
    alone: bool,
    baked: int | None,
    by_hand: Mapping[str, float | str | frozenset[str] | None],
) -> tuple[Settings, str]:
    """What `choose` chooses, with what was fixed by hand or by a bake on top.

    Parameters
    ----------
    baked : levels of a bake's rays, or None where they are traced
    """
    chosen, reason = choose(material, alone)
    if baked is None:
        return chosen.with_defaults(**by_hand), reason
    if by_hand.get("levels") is None:
        chosen = replace(chosen, levels=max(chosen.levels, baked))
    return chosen.with_defaults(**{**by_hand, "rays": baked}), reason


def choose(material: Material, alone: bool = False) -> tuple[Settings, str]:
    """Settings for a material, and the reason in words.

    With these, bench/accuracy.py and bench/path_tracer.py found the errors that the README lists.

    Parameters
    ----------
    alone : True for points that share no pixel with others (vertices): their own rays are all they have. The
        sub-pixel points of one pixel send theirs to different places in the cells, so a quarter of the rays of each
        are enough, given the weight of `hemisphere.ray_weights`.
    """
    alpha = material.roughness
    if alpha >= 0.25:
        # A lobe sees part of the hemisphere, where the places of the rays average less.
        settings = Settings(levels=5, rays=5 if alpha < 0.6 else 4, keep=5, views=128)
    elif alpha >= 0.08:
        settings = Settings(levels=6, rays=5, keep=6, views=256)
    else:
        settings = Settings(levels=7, rays=5, keep=7, views=512, pixel_error=0.02)
    if alone:
        settings = replace(settings, rays=min(settings.levels, settings.rays + 1))
    return settings, f"{material.spec}: its lobe is as wide as that of GGX alpha {alpha:.3g}"
