"""Materials that a mesh's own colour multiplies: albedo from vertex colours and textures.

f is linear in what the colour multiplies, so radiance is, too: a point of colour c reflects L₀ + c (L₁ − L₀), with L₁
of the material under white and L₀ of what no colour multiplies (`Material.untinted`). Slices and cuts are made for
those two; a texture costs none of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from prtcl.factors.material import Material
from prtcl.scene.mesh import Mesh
from prtcl.transport.pipeline import Points

Radiance = npt.NDArray[np.floating]
Rows = slice | npt.NDArray[np.intp]
BLACK = Material.parse("lambert:albedo=0")


class Tints:
    """Which of some materials are tinted, and what is left of each without.

    Attributes
    ----------
    materials : those given, then what is left of the tinted ones, where that is not black
    parent : for each of them, which of those given it comes from
    tinted : (given,) whether the mesh's colour matters
    left : (given,) which of `materials` is left of each; -1 for nothing
    """

    def __init__(self, given: Sequence[Material], mesh: Mesh) -> None:
        self.materials, self.parent = list(given), list(range(len(given)))
        self.tinted = np.array([bool(material.tints) for material in given]) & bool(mesh.coloured.any())
        self.left = np.full(len(given), -1)
        for number in map(int, np.flatnonzero(self.tinted)):
            left = given[number].untinted
            if not left.black:
                self.left[number] = len(self.materials)
                self.materials.append(left)
                self.parent.append(number)

    def radiance(
        self,
        shade: Callable[[Points, Rows], Radiance],
        points: Points,
        colour: Callable[[npt.NDArray[np.intp]], Radiance],
    ) -> Radiance:
        """Radiance (n, 3) of points, shaded once, or twice where a tinted material has something left.

        Parameters
        ----------
        shade : for some of the points, whose `material` indexes `materials`, and which of them these are
        colour : the mesh's, (k, 3), of some of the points
        """
        full = shade(points, slice(None))
        at = np.flatnonzero(self.tinted[points.material])
        if len(at):
            left = np.zeros((len(at), 3), dtype=full.dtype)
            index = self.left[points.material[at]]
            some = np.flatnonzero(index >= 0)
            if len(some):
                again = replace(points[at[some]], material=index[some].astype(np.int32))
                left[some] = shade(again, at[some])
            full[at] = left + colour(at) * (full[at] - left)
        return full


def colour_notes(given: Sequence[Material], mesh: Mesh) -> list[str]:
    """A note where a material asks for a colour that the mesh has not."""
    asking = [m.spec for m in given if m.tints]
    if asking and not mesh.coloured.any():
        return [f"{asking[0]}: {mesh.name} has no colours of its own; they are taken as white"]
    return []
