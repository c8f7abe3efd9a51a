"""Measured isotropic reflectance on nodes of (θ_h, θ_d, φ_d): the one form that every measured format is read into.

Sources are MERL's own layout, and others resampled to it (`prtcl.factors.measured_files`). `bivariate` leaves φ_d out,
which makes it editable; `prtcl.factors.reduction` says what that costs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors import three_angles
from prtcl.factors.bivariate import Bivariate, directions, interval, merl_nodes
from prtcl.factors.material import LARGEST, Material

MERL_TURNS = 180
"""Bins of φ_d in MERL's layout, over half a turn."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measured:
    """f(θ_h, θ_d, φ_d) at bin centres: trilinear in (√θ_h, θ_d, φ_d), clamped in the thetas, periodic in φ_d.

    Attributes
    ----------
    values : (nh, nd, np, 3) float64, 1/sr, linear RGB, 0 or more; where not valid, filled in (see `make`)
    theta_h, theta_d : (nh,), (nd,) float64, radians, ascending, from 0 to π/2
    valid : (nh, nd, np) bool, whether the sample was measured
    name : for messages
    notes : what people should know
    """

    values: Array
    theta_h: Array
    theta_d: Array
    valid: npt.NDArray[np.bool_]
    name: str = "measured"
    notes: tuple[str, ...] = ()

    @classmethod
    def make(
        cls,
        values: npt.ArrayLike,
        theta_h: npt.ArrayLike,
        theta_d: npt.ArrayLike,
        valid: npt.ArrayLike | None = None,
        *,
        name: str = "measured",
        notes: tuple[str, ...] = (),
    ) -> Measured:
        """Check and complete: a negative sample becomes invalid, and invalid ones get a value that fills the gap.

        That value is the mean of the measured samples with the same θ_h and θ_d; where there is none, that of the
        nearest (θ_h, θ_d) that have some.

        Parameters
        ----------
        values : (nh, nd, np, 3), finite where valid; φ_d of sample k is (k + ½) π/np
        valid : (nh, nd, np) bool; None takes every sample that is not negative

        Raises
        ------
        InputError
            If shapes do not fit, or a valid value or an angle is not finite, nodes do not ascend, or nothing is valid.
        """
        table = np.asarray(values, np.float64)
        nodes = [np.asarray(n, np.float64) for n in (theta_h, theta_d)]
        if (
            table.ndim != 4
            or table.shape[3] != 3
            or table.shape[:2] != tuple(n.size for n in nodes)
            or not table.size
        ):
            raise InputError(
                f"{name}: expected values[nh, nd, np, 3] and two node lists, got {table.shape} and "
                f"{', '.join(str(n.size) for n in nodes)} nodes"
            )
        for key, n in zip(("theta_h", "theta_d"), nodes, strict=True):
            if (
                n.ndim != 1
                or not np.isfinite(n).all()
                or (np.diff(n) <= 0).any()
                or n[0] < 0
                or n[-1] > np.pi / 2 + 1e-6
            ):
                raise InputError(f"{name}: {key} expected strictly ascending angles from 0 to pi/2 radians")
        mask = np.ones(table.shape[:3], np.bool_) if valid is None else np.asarray(valid)
        if mask.dtype != np.bool_ or mask.shape != table.shape[:3]:
            raise InputError(f"{name}: valid expected bool {table.shape[:3]}, got {mask.dtype} {mask.shape}")
        if not np.isfinite(table[mask]).all():
            raise InputError(f"{name}: expected finite values; some are NaN or infinite")
        if np.abs(table[mask]).max(initial=0.0) > LARGEST:
            raise InputError(
                f"{name}: values expected below {LARGEST:g} 1/sr, got up to {np.abs(table[mask]).max():g}"
            )
        with np.errstate(invalid="ignore"):
            negative = mask & (table < 0).any(axis=-1)
        mask = mask & ~negative
        if not mask.any():
            raise InputError(f"{name}: no sample is valid; is it a BRDF?")
        if negative.any():
            notes = (
                *notes,
                f"{name}: {int(negative.sum())} of {negative.size} samples are negative; they are left out",
            )
        if not mask.all():
            mean, known = _means(table, mask)
            table = np.where(mask[..., None], table, filled(mean, known)[:, :, None])
        return cls(table, nodes[0], nodes[1], mask, name, notes)

    @classmethod
    def sample(
        cls,
        f: Callable[[Array, Array], Array],
        *,
        least: float = 0.0,
        name: str = "measured",
        notes: tuple[str, ...] = (),
    ) -> Measured:
        """A function of incident and outgoing directions on MERL's nodes, made reciprocal: the mean of both orders.

        Nodes where a direction's cosine is not above `least`, which 0 makes the horizon, are invalid. `f` is called
        twice for each θ_h, with up to (90 · 180, 3) directions.
        """
        h, d = merl_nodes()
        turn = turns(MERL_TURNS)
        values = np.zeros((h.size, d.size, turn.size, 3))
        valid = np.zeros(values.shape[:3], np.bool_)
        for row, theta in enumerate(h):
            i, o = directions(theta, d[:, None], turn)
            valid[row] = (i[..., 2] > least) & (o[..., 2] > least)
            i, o = i[valid[row]], o[valid[row]]
            values[row][valid[row]] = (f(i, o) + f(o, i)) / 2
        return cls.make(values, h, d, valid, name=name, notes=notes)

    @classmethod
    def of(cls, material: Material) -> Measured:
        """What a material of kind "measured" looks up."""
        assert material.kind == "measured" and material.table is not None
        own = material.table
        name = material.spec or "measured"
        return cls(own["values"], own["theta_h"], own["theta_d"], own["valid"] > 0, name, material.notes)

    @cached_property
    def above(self) -> npt.NDArray[np.bool_]:
        """(nh, nd, np): whether both directions of a node are above the horizon."""
        i, o = directions(self.theta_h[:, None, None], self.theta_d[:, None], turns(self.valid.shape[2]))
        return (i[..., 2] > 0) & (o[..., 2] > 0)

    @property
    def table(self) -> dict[str, Array]:
        """The arrays as a `Material` and `prtcl.reference` take them; valid as 0 and 1."""
        return {
            "values": self.values,
            "theta_h": self.theta_h,
            "theta_d": self.theta_d,
            "valid": self.valid.astype(np.float64),
        }

    @cached_property
    def _entries(self) -> tuple[Array, Array, Array]:
        return three_angles.entries(self.table)

    def evaluate(self, incident: npt.ArrayLike, outgoing: npt.ArrayLike) -> Array:
        """f of pairs of unit directions, (..., 3) in the frame of the normal, which broadcast; 0 below the horizon.

        Trilinear as `prtcl.factors.three_angles` says: samples that were not measured are left out.
        """
        i, o = np.broadcast_arrays(np.asarray(incident, np.float64), np.asarray(outgoing, np.float64))
        f = self.at(*three_angles.angles(i, o))
        return np.where(((i[..., 2] > 0) & (o[..., 2] > 0))[..., None], f, 0.0)

    def at(self, theta_h: Array, theta_d: Array, phi_d: Array) -> Array:
        """f at angles of one shape: (..., 3)."""
        total = self.weighted(theta_h, theta_d, phi_d)
        return np.asarray(total[..., :3] / total[..., 3:])

    def weighted(self, theta_h: Array, theta_d: Array, phi_d: Array) -> Array:
        """Σ w m f for each channel, and Σ w m: 1 where all the samples about were measured. (..., 4)."""
        roots, nodes, table = self._entries
        count = table.shape[2]
        (h, wh), (d, wd) = interval(roots, np.sqrt(theta_h)), interval(nodes, theta_d)
        place = phi_d * (count / np.pi) - 0.5
        low = np.floor(place)
        wp, p = place - low, low.astype(np.int64) % count
        ends_h = ((h, 1 - wh), (np.minimum(h + 1, roots.size - 1), wh))
        ends_d = ((d, 1 - wd), (np.minimum(d + 1, nodes.size - 1), wd))
        total: Array = np.zeros((*place.shape, 4))
        for at_h, by_h in ends_h:
            for at_d, by_d in ends_d:
                for at_p, by_p in ((p, 1 - wp), ((p + 1) % count, wp)):
                    total += (by_h * by_d * by_p)[..., None] * table[at_h, at_d, at_p]
        return total

    def bivariate(self) -> Bivariate:
        """Without φ_d: the mean over it of the valid samples whose two directions are above the horizon.

        Those below it say nothing of what can be seen: no pair of directions has them, whatever a file holds there.
        (θ_h, θ_d) with none are invalid in the table's mask, filled from their neighbours and counted in the notes.
        """
        mean, known = _means(self.values, self.valid & self.above)
        if not known.any():
            raise InputError(f"{self.name}: no sample above the horizon is valid; is it a BRDF?")
        notes = self.notes
        if not known.all():
            notes = (
                *notes,
                f"{self.name}: {int((~known).sum())} of {known.size} pairs of theta_h and theta_d have no measurement; "
                "they are filled from their neighbours",
            )
        return Bivariate.make(
            filled(mean, known), self.theta_h, self.theta_d, known, name=self.name, notes=notes
        )

    def material(self, spec: str = "") -> Material:
        """It as what scenes and sessions take: looked up in three angles."""
        return Material("measured", {}, table=self.table, spec=spec or self.name, notes=self.notes)


def turns(count: int) -> Array:
    """φ_d of the bin centres: (k + ½) π/count."""
    return np.asarray((np.arange(count) + 0.5) * (np.pi / count))


def merl_layout(
    values: npt.ArrayLike, valid: npt.ArrayLike | None = None, *, name: str = "measured"
) -> Measured:
    """Values (90, 90, 180, 3) on MERL's bin centres."""
    h, d = merl_nodes()
    return Measured.make(values, h, d, valid, name=name)


def filled(values: Array, known: npt.NDArray[np.bool_]) -> Array:
    """(nh, nd, 3) with what is not known replaced by the mean of its known neighbours, ring after ring."""
    out, done = np.where(known[..., None], values, 0.0), known.copy()
    while not done.all():
        total, count = np.zeros_like(out), np.zeros(done.shape)
        for axis in (0, 1):
            for step in (-1, 1):
                # Rolled off one edge, a row enters at the other; it is no neighbour there.
                edge = [slice(None)] * 2
                edge[axis] = slice(0, 1) if step > 0 else slice(-1, None)
                there = np.roll(done, step, axis)
                there[tuple(edge)] = False
                total += np.where(there[..., None], np.roll(out, step, axis), 0.0)
                count += there
        new = ~done & (count > 0)
        out[new] = total[new] / count[new][:, None]
        done |= new
    return out


def _means(values: Array, mask: npt.NDArray[np.bool_]) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Mean over φ_d of the masked samples, (nh, nd, 3), and where there is one."""
    count = mask.sum(axis=2)
    total = np.where(mask[..., None], values, 0.0).sum(axis=2)
    return np.asarray(total / np.maximum(count, 1)[..., None]), count > 0
