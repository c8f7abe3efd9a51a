"""W_v, the linear operator from a bivariate table to the slices f_v, and its adjoint; matrix-free, on the device.

f_v = W_v f̃ (Sitthi-Amorn et al.): each sample of a slice is a fixed weighted sum of table entries, and the Haar
transform is orthonormal, so the adjoint is that of the sampling after an inverse transform. An edit of the table goes
forward through W_v; what images say about the table comes back through W_vᵀ.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors import hemisphere
from prtcl.factors.environment import Light
from prtcl.factors.material import KINDS, Material, from_table, pack
from prtcl.factors.slices import GRAZING
from prtcl.wavelet import haar
from prtcl.wavelet.triple import accumulator_dtype

GROUP = 64
TABLE_KIND = 1 << KINDS.index("table")
"""The only kind that the kernels here need know."""
SUB = 2
"""Levels of subsamples in a cell: a W_v is linear only if they do not depend on the table, as `subsamples` does."""

Array = npt.NDArray[np.float64]


class SliceOperator:
    """W_v for tables on given nodes.

    Parameters
    ----------
    device : where it runs; rows are stored in its precision, sums taken in its accumulator's
    theta_h, theta_d : (nh,), (nd,) node angles in radians, ascending, from 0 to π/2
    levels : of the slices, which have 4**levels samples
    channels : 3, or 1
    sub : each sample is averaged over 4**sub directions

    Raises
    ------
    InputError
        If the nodes do not ascend, or `channels` is neither 1 nor 3.

    Notes
    -----
    Values may be negative here (a difference of tables has slices, too): only a `Bivariate` may not.
    """

    def __init__(
        self, device: Device, theta_h: npt.ArrayLike, theta_d: npt.ArrayLike, levels: int, channels: int = 3,
        sub: int = SUB,
    ) -> None:  # fmt: skip
        if channels not in (1, 3):
            raise InputError(f"channels: expected 1 or 3, got {channels}")
        shape = np.size(theta_h), np.size(theta_d)
        checked = from_table(np.zeros(shape), theta_h, theta_d, name="nodes").table
        assert checked is not None
        self.device, self.levels, self.channels, self.sub = device, levels, channels, sub
        self.theta_h, self.theta_d = checked["theta_h"], checked["theta_d"]
        self.kernels = device.kernels(
            "bivariate.cl", LEVELS=levels, SUB=sub, CHANNELS=channels, KINDS=TABLE_KIND,
            GROUP=self.group,
        )  # fmt: skip
        self.nodes = self.pack(np.zeros((*shape, channels)))[2]

    @property
    def group(self) -> int:
        """Rows of the adjoint in a work-group: one on a CPU, whose threads a wide group would leave idle."""
        return 1 if self.device.is_cpu else GROUP

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of a table: nodes of θ_h, of θ_d, channels."""
        return self.theta_h.size, self.theta_d.size, self.channels

    @property
    def directions(self) -> Any:
        """4**(levels + sub) local directions with their mean cosines, on the device."""
        depth = self.levels + self.sub
        return self.device.constant(("directions", depth), partial(hemisphere.directions, depth))

    def pack(self, values: npt.ArrayLike) -> tuple[Any, Any, Any]:
        """A table (nh, nd, channels) as the kernels take a material: ints, reals, tables.

        Raises
        ------
        InputError
            If the shape is another.
        """
        table = np.asarray(values, np.float64)
        if table.shape != self.shape:
            raise InputError(f"values: expected shape {self.shape}, got {table.shape}")
        rgb = np.broadcast_to(table, (*table.shape[:2], 3))
        # Not `from_table`, which takes negative values for 0: W_v is linear in all of them.
        own = Material("table", {}, {"values": rgb, "theta_h": self.theta_h, "theta_d": self.theta_d})
        ints, reals, tables = pack([own])
        device = self.device
        return device.array(ints, np.int32), device.array(reals), device.array(tables)

    def outgoing(self, views: npt.ArrayLike) -> Array:
        """Local outgoing directions (n, 3) as rows of four, lifted off the horizon as for `Materials.slices`."""
        own = np.atleast_2d(np.asarray(views, np.float64))
        if own.ndim != 2 or own.shape[1] != 3:
            raise InputError(f"views: expected (n, 3) local directions, got {own.shape}")
        padded = np.zeros((len(own), 4))
        padded[:, :3] = own
        padded[:, 2] = np.maximum(padded[:, 2], GRAZING)
        return padded

    def samples(self, values: npt.ArrayLike, views: npt.ArrayLike) -> Any:
        """W_v f̃ before the Haar transform: device array (views, channels, 4**levels)."""
        outgoing, device = self.outgoing(views), self.device
        out = device.empty((len(outgoing), self.channels, 4**self.levels))
        kernel = device.kernels(
            "brdf.cl", LEVELS=self.levels, SUB=self.sub, CHANNELS=self.channels,
            KINDS=TABLE_KIND, GROUP=GROUP,
        )["brdf_slices"]  # fmt: skip
        device.launch(
            kernel, 4**self.levels, GROUP, *self.pack(values), 0, self.directions, device.array(outgoing),
            out, 0, y=len(outgoing),
        )  # fmt: skip
        return out

    def forward(self, values: npt.ArrayLike, views: npt.ArrayLike) -> Any:
        """W_v f̃ for every view: device array (views, channels, 4**levels) of Haar coefficients.

        Parameters
        ----------
        values : (nh, nd, channels), of any sign
        views : (n, 3) local outgoing directions
        """
        return haar.forward(self.device, self.samples(values, views))

    def adjoint(self, coefficients: Any, views: npt.ArrayLike, *, per_view: bool = False) -> Array:
        """Σ_v W_vᵀ g_v, or each view's own.

        Parameters
        ----------
        coefficients : (views, channels, 4**levels), host or device
        views : (n, 3)

        Returns
        -------
        table : (nh, nd, channels) float64; (views, nh, nd, channels) where `per_view`
        """
        g = self.device.array(coefficients, name="coefficients")
        outgoing = self.outgoing(views)
        wanted = (len(outgoing), self.channels, 4**self.levels)
        if tuple(g.shape) != wanted:
            raise InputError(f"coefficients: expected shape {wanted}, got {tuple(g.shape)}")
        rows = self.rows(len(outgoing))
        self.add_soft(rows, haar.inverse(self.device, g), outgoing)
        out = np.asarray(rows.get(), np.float64).reshape(-1, *self.shape)
        return out if per_view else np.asarray(out.sum(axis=0))

    def rows(self, count: int) -> Any:
        """So many tables of zeros, for what is added to: device array (count, nh · nd · channels) of sums."""
        dtype = accumulator_dtype(self.device)
        return self.device.array(np.zeros((count, int(np.prod(self.shape))), dtype), dtype)

    def add_soft(
        self, rows: Any, samples: Any, outgoing: npt.ArrayLike, per_row: int = 1, scale: float = 1.0
    ) -> None:
        """rows[r] += scale · Σ W_vᵀ of the samples of points r · per_row … (r + 1) · per_row − 1.

        Parameters
        ----------
        rows : device array as `rows` makes it
        samples : device array (rows · per_row, channels, 4**levels)
        outgoing : (rows · per_row, 4) local outgoing directions; nothing is added for one below the horizon
        """
        self.device.launch(
            self.kernels["table_adjoint"], rows.shape[0], self.group, self.nodes, *self.shape[:2],
            self.directions, self.device.array(outgoing), samples, per_row, float(scale), rows, rows.shape[0],
        )  # fmt: skip

    def add_hard(
        self, rows: Any, light: Light, bits: npt.NDArray[np.uint32], frames: npt.NDArray[np.float32],
        outgoing: npt.ArrayLike, per_row: int = 1, scale: float = 1.0,
    ) -> None:  # fmt: skip
        """rows[r] += scale · Σ_points Σ_l V(ω_l) max(n·ω_l, 0) E_l b(ω_l): the light's peaks, as exact directions.

        Parameters
        ----------
        bits : (points, words), which hard samples each point sees
        frames : (points, 3, 3) world frames
        rows, outgoing, per_row, scale : as for `add_soft`
        """
        if not len(light.hard):
            return
        device = self.device
        _, hard = light.buffers(device)
        device.launch(
            self.kernels["table_adjoint_lights"], rows.shape[0], self.group, self.nodes, *self.shape[:2], hard,
            len(light.hard), device.array(bits, np.uint32), device.array(frames), device.array(outgoing),
            per_row, float(scale), rows, rows.shape[0],
        )  # fmt: skip
