"""Bivariate tables f̃(θ_h, θ_d), the form in which measured and edited reflectance is kept.

θ_h is the angle between the half vector and the normal, θ_d the one between the half vector and either direction:
the two angles that remain of Rusinkiewicz's three when φ_d, the turn about the half vector, is left out. The BRDF is
linear in the table (`Sitthi-Amorn et al.`, f_v = W_v f̃), so editing, mixing and fitting are done on it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors.material import Material, from_table
from prtcl.files.atomic import replacing
from prtcl.files.npz import read_npz

MERL_NODES = 90
"""Nodes of θ_h and of θ_d in MERL's layout."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Bivariate:
    """f̃(θ_h, θ_d) at its nodes: bilinear between them, clamped outside.

    Attributes
    ----------
    values : (nh, nd, 3) float64, 1/sr, linear RGB, 0 or more; finite where invalid, too (filled by the reader)
    theta_h, theta_d : (nh,), (nd,) float64, radians, ascending, from 0 to π/2
    valid : (nh, nd) bool, False where the source has no measurement and the value was filled in
    name : for messages
    notes : what people should know, such as how many samples were negative
    """

    values: Array
    theta_h: Array
    theta_d: Array
    valid: npt.NDArray[np.bool_]
    name: str = "table"
    notes: tuple[str, ...] = ()

    @classmethod
    def make(
        cls,
        values: npt.ArrayLike,
        theta_h: npt.ArrayLike,
        theta_d: npt.ArrayLike,
        valid: npt.ArrayLike | None = None,
        *,
        name: str = "table",
        notes: tuple[str, ...] = (),
    ) -> Bivariate:
        """A table, checked as `prtcl.factors.material.from_table` checks it; negative values become 0 and are noted.

        Raises
        ------
        InputError
            If shapes do not fit, or a value or an angle is not finite, or the nodes do not ascend.
        """
        material = from_table(values, theta_h, theta_d, name=name)
        assert material.table is not None
        checked = material.table
        mask = np.ones(checked["values"].shape[:2], np.bool_) if valid is None else np.asarray(valid)
        if mask.dtype != np.bool_ or mask.shape != checked["values"].shape[:2]:
            raise InputError(
                f"{name}: valid expected bool {checked['values'].shape[:2]}, got {mask.dtype} {mask.shape}"
            )
        return cls(
            checked["values"], checked["theta_h"], checked["theta_d"], mask, name, (*notes, *material.notes)
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Nodes of θ_h and of θ_d."""
        return self.theta_h.size, self.theta_d.size

    def material(self, spec: str = "") -> Material:
        """The table as what scenes and sessions take."""
        own = from_table(self.values, self.theta_h, self.theta_d, name=self.name, spec=spec)
        return replace(own, notes=(*self.notes, *own.notes))

    def evaluate(self, theta_h: npt.ArrayLike, theta_d: npt.ArrayLike) -> Array:
        """f̃ at any angles, which broadcast: (..., 3)."""
        h, d = np.broadcast_arrays(np.asarray(theta_h, np.float64), np.asarray(theta_d, np.float64))
        (i, wi), (j, wj) = interval(self.theta_h, h), interval(self.theta_d, d)
        i1, j1 = np.minimum(i + 1, self.theta_h.size - 1), np.minimum(j + 1, self.theta_d.size - 1)
        wi, wj = wi[..., None], wj[..., None]
        low = self.values[i, j] * (1 - wj) + self.values[i, j1] * wj
        high = self.values[i1, j] * (1 - wj) + self.values[i1, j1] * wj
        return np.asarray(low * (1 - wi) + high * wi)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the .npz that `table:FILE.npz` reads, aside and then renamed."""
        with replacing(path) as aside, aside.open("wb") as file:
            np.savez(file, values=self.values, theta_h=self.theta_h, theta_d=self.theta_d, valid=self.valid)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Bivariate:
        """Read values[nh, nd, 3], theta_h[nh], theta_d[nd] and, where it is there, valid[nh, nd] from an .npz.

        Raises
        ------
        InputError
            If the file cannot be read or holds no such table.
        """
        found = read_npz(path, "a table of values, theta_h and theta_d")
        missing = [key for key in ("values", "theta_h", "theta_d") if key not in found]
        if missing:
            raise InputError(
                f"{os.fspath(path)}: expected arrays values, theta_h and theta_d, "
                f"found {', '.join(found) or 'nothing'}"
            )
        return cls.make(
            found["values"], found["theta_h"], found["theta_d"], found.get("valid"), name=os.fspath(path)
        )


def interval(nodes: Array, angle: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """The lower node of the interval that holds each angle, and the weight of its upper end; clamped outside."""
    if nodes.size == 1:
        return np.zeros(angle.shape, np.intp), np.zeros(angle.shape)
    low = np.clip(np.searchsorted(nodes, angle, side="right") - 1, 0, nodes.size - 2)
    weight = np.clip((angle - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)
    return low, weight


def merl_nodes() -> tuple[Array, Array]:
    """Bin centres of MERL's layout: θ_h at ((i + ½)/90)² · 90°, θ_d at (j + ½) · 1°."""
    steps = (np.arange(MERL_NODES) + 0.5) / MERL_NODES
    return steps**2 * (np.pi / 2), steps * (np.pi / 2)


def directions(theta_h: npt.ArrayLike, theta_d: npt.ArrayLike, phi_d: npt.ArrayLike) -> tuple[Array, Array]:
    """Incident and outgoing unit directions of Rusinkiewicz's angles, the half vector in the plane φ_h = 0.

    Angles broadcast; each result is (..., 3) in the frame of the normal, z up. Some lie below the horizon.
    """
    h, d, p = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (theta_h, theta_d, phi_d)))
    half = np.stack([np.sin(h), np.zeros_like(h), np.cos(h)], axis=-1)
    # The incident direction about the half vector, turned from the pole to it about the y axis.
    x, y, z = np.sin(d) * np.cos(p), np.sin(d) * np.sin(p), np.cos(d)
    incident = np.stack([x * np.cos(h) + z * np.sin(h), y, z * np.cos(h) - x * np.sin(h)], axis=-1)
    return incident, 2 * np.sum(half * incident, axis=-1, keepdims=True) * half - incident
