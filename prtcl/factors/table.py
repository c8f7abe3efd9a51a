"""`prtcl.Table`: a bivariate BRDF to edit in a script, one edit after another."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors import albedo, table_edit, table_parts
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.material import Material
from prtcl.factors.table_edit import SOFTNESS, Curve
from prtcl.factors.tabulate import tabulate

Degrees = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Table:
    """A bivariate table f̃(θ_h, θ_d); each edit gives another, and this one stays as it is.

    The edits are those of `prtcl.factors.table_edit` and `table_parts`, where each is defined.

    Attributes
    ----------
    bivariate : nodes, values (nh, nd, 3) in 1/sr, mask and notes

    Examples
    --------
    >>> gold = Table.of("ggx:alpha=0.2,f0=1.0/0.77/0.34")
    >>> brushed = gold.sharpened(0.5).tinted(0.9, 0.9, 1.0)
    >>> round(brushed.energy, 2) <= 1.0
    True
    >>> session.material = brushed.material()  # doctest: +SKIP
    """

    bivariate: Bivariate

    @classmethod
    def of(cls, material: Material | Bivariate | Table | str) -> Table:
        """The table of a SPEC, a `Material` (tabulated, unless it is a table) or a `Bivariate`."""
        if isinstance(material, Table):
            return material
        return cls(material if isinstance(material, Bivariate) else tabulate(material))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Table:
        """Read an .npz of values, theta_h and theta_d; raises InputError where it is none."""
        return cls(Bivariate.load(path))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the .npz that `table:FILE.npz` reads."""
        self.bivariate.save(path)

    def material(self) -> Material:
        """What scenes and sessions take; every call makes another, which a session fits cuts to anew."""
        return self.bivariate.material()

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, and what else people should know."""
        return self.bivariate.notes

    @property
    def energy(self) -> float:
        """The largest albedo over incidence and channel; above 1 it reflects more than it receives."""
        return albedo.energy(self.bivariate)[0]

    def albedo(self, cosines: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Directional albedo (n, 3) at cosines of the angle of incidence."""
        return albedo.albedo(self.bivariate, cosines)

    # --- edits ----------------------------------------------------------------------------------------------

    def scaled(self, factor: float) -> Table:
        """All values times a factor."""
        return Table(table_edit.scale(self.bivariate, factor))

    def tinted(self, red: float, green: float, blue: float) -> Table:
        """Each channel times its factor, linear."""
        return Table(table_edit.tint(self.bivariate, (red, green, blue)))

    def sharpened(self, factor: float) -> Table:
        """The lobe narrower (above 1) or wider (below), the energy kept."""
        return Table(table_parts.sharpen(self.bivariate, factor))

    def balanced(self, amount: float) -> Table:
        """A share of the energy moved from diffuse to specular (above 0, to 1) or back (below, to −1)."""
        return Table(table_parts.balance(self.bivariate, amount))

    def with_fresnel(self, strength: float) -> Table:
        """The rise towards grazing angles times a strength; 1 changes nothing."""
        return Table(table_parts.fresnel(self.bivariate, strength))

    def with_fresnel_curve(self, curve: Curve) -> Table:
        """Another curve over θ_d for the specular part, by its shape."""
        return Table(table_parts.replace_fresnel(self.bivariate, curve))

    def with_lobe(self, curve: Curve) -> Table:
        """Another curve over θ_h, in 1/sr."""
        return Table(table_edit.replace_theta_h(self.bivariate, curve))

    def blended(self, other: Material | Bivariate | Table | str, t: float) -> Table:
        """(1 − t) of this and t of another."""
        return Table(table_edit.blend(self.bivariate, Table.of(other).bivariate, t))

    def painted(
        self,
        theta_h: Degrees,
        theta_d: Degrees,
        *,
        factor: npt.ArrayLike | None = None,
        value: npt.ArrayLike | None = None,
        softness: float = SOFTNESS,
    ) -> Table:
        """A region, from and to in degrees, times a factor or set to a value (1/sr), with a soft edge."""
        regions = []
        for key, ends in (("theta_h", theta_h), ("theta_d", theta_d)):
            if np.shape(ends) != (2,):
                raise InputError(f"{key}: expected two angles in degrees, got {ends}")
            regions.append((float(np.radians(ends[0])), float(np.radians(ends[1]))))
        painted = table_edit.paint(self.bivariate, *regions, factor=factor, value=value, softness=softness)
        return Table(painted)

    def conserved(self) -> Table:
        """Scaled down to an energy of 1 where it is above."""
        return Table(table_edit.conserve(self.bivariate))
