"""The slices of a table at some views, kept while the table is edited: only what reads an edited node is made anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.slice_operator import TABLE_KIND, SliceOperator
from prtcl.factors.slices import GROUP, subsamples
from prtcl.wavelet import haar

Array = npt.NDArray[np.float64]
REST = 0.5
"""Share of touched slices from which all are transformed in one go: picking some out costs two copies."""


class TableSlices:
    """f_v of one table at given views, samples and coefficients on the device, through local edits.

    Because f_v = W_v f̃ is linear and each cell of a hemisphere reads a few neighbouring nodes, an edit of part of the
    table changes a few cells. Which, a *plan* knows: the lowest and highest node of θ_h and of θ_d that each cell's
    subsamples read, made once on the device (8 bytes a cell, `kernels/bivariate.cl`).

    Parameters
    ----------
    device : where it runs
    table : what is edited first; its nodes stay
    views : (n, 3) local outgoing directions
    levels : of the slices
    sub : 4**sub subsamples a cell; None takes what the table's sharpness needs now, and keeps that

    Attributes
    ----------
    samples, coefficients : device arrays (views, 3, 4**levels); the coefficients are what `Materials.slices` gives for
        the table with these subsamples, bit for bit
    made : cells made at the last edit, of views · 4**levels
    transformed : slices transformed then
    """

    def __init__(
        self, device: Device, table: Bivariate, views: npt.ArrayLike, levels: int, sub: int | None = None
    ) -> None:
        depth = subsamples(table.material(), levels) if sub is None else sub
        self.device, self.levels = device, levels
        self.operator = SliceOperator(device, table.theta_h, table.theta_d, levels, 3, depth)
        self.views = np.atleast_2d(np.asarray(views, np.float64))
        self._outgoing = device.array(self.operator.outgoing(views))
        self.values: Array = table.values.copy()
        self.samples = self.operator.samples(self.values, views)
        self.coefficients = haar.forward(device, self.samples)
        self.made, self.transformed = len(self.views) * 4**levels, len(self.views)
        self._plan = self._cell_nodes()

    def _cell_nodes(self) -> npt.NDArray[np.int16]:
        """(4, views · 4**levels): lowest and highest node of θ_h, lowest and highest of θ_d that each cell reads."""
        count, cells = len(self.views), 4**self.levels
        out = self.device.empty((count, cells, 4), np.int16)
        operator = self.operator
        self.device.launch(
            operator.kernels["table_cell_nodes"], cells, operator.group, operator.nodes, *operator.shape[:2],
            operator.directions, self._outgoing, out, y=count,
        )  # fmt: skip
        return np.ascontiguousarray(out.get().reshape(-1, 4).T)

    def edit(self, theta_h: slice, theta_d: slice, values: npt.ArrayLike) -> None:
        """Replace the nodes [theta_h, theta_d] by `values`, which broadcast to (nodes, nodes, 3)."""
        table = self.values.copy()
        table[theta_h, theta_d] = values
        self.update(table)

    def update(self, values: npt.ArrayLike) -> None:
        """Take another table on the same nodes; what differs is found.

        Raises
        ------
        InputError
            If the shape is another, or a value is not finite or negative.
        """
        table = np.array(values, np.float64)
        if table.shape != self.values.shape:
            raise InputError(f"values: expected shape {self.values.shape}, got {table.shape}")
        if not (np.isfinite(table).all() and (table >= 0).all()):
            raise InputError("values: expected finite reflectance, 0 or more")
        changed = (table != self.values).any(axis=2)
        self.values = table
        cells = self.reading(changed)
        self.made, self.transformed = len(cells), 0
        if not len(cells):
            return
        operator, device = self.operator, self.device
        device.launch(
            self._cells_kernel, len(cells), GROUP, *operator.pack(table), operator.directions, self._outgoing,
            device.array(cells, np.int32), self.samples, len(cells), stage="brdf_slices",
        )  # fmt: skip
        self._transform(np.unique(cells >> (2 * self.levels)))

    def reading(self, changed: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
        """Cells, as view · 4**levels + cell, that may read any of the nodes (nh, nd) that are set.

        A cell counts where the rectangle of nodes between its lowest and highest holds one of them.
        """
        rows, columns = np.nonzero(changed)
        if not rows.size:
            return np.zeros(0, np.int32)
        low_h, high_h, low_d, high_d = self._plan
        about = (low_h <= rows.max()) & (high_h >= rows.min())
        about &= (low_d <= columns.max()) & (high_d >= columns.min())
        cells = np.flatnonzero(about)
        if rows.size < (np.ptp(rows) + 1) * (np.ptp(columns) + 1):  # not all of it: count in each cell's own
            sums = np.zeros((changed.shape[0] + 1, changed.shape[1] + 1), np.int32)
            sums[1:, 1:] = changed.cumsum(axis=0).cumsum(axis=1)
            h0, h1, d0, d1 = (self._plan[k][cells].astype(np.intp) for k in range(4))
            inside = sums[h1 + 1, d1 + 1] - sums[h0, d1 + 1] - sums[h1 + 1, d0] + sums[h0, d0]
            cells = cells[inside > 0]
        return cells.astype(np.int32)

    @property
    def _cells_kernel(self) -> Any:
        operator = self.operator
        return self.device.kernels(
            "bivariate.cl", LEVELS=self.levels, SUB=operator.sub, CHANNELS=3, KINDS=TABLE_KIND, GROUP=GROUP
        )["table_update_cells"]

    def _transform(self, views: npt.NDArray[np.integer]) -> None:
        """The coefficients of some views from their samples."""
        device, cells = self.device, 4**self.levels
        self.transformed = len(self.views)
        if len(views) > REST * len(self.views):
            haar.forward(device, self.samples, out=self.coefficients)
            return
        self.transformed = len(views)
        rows, coefficients = (x.reshape(-1, cells) for x in (self.samples, self.coefficients))
        own = device.empty((3 * len(views), cells))
        ends = [*(np.flatnonzero(np.diff(views) > 1) + 1).tolist(), len(views)]
        runs = list(zip([0, *ends[:-1]], ends, strict=True))  # of views that follow each other
        for start, end in runs:
            first = 3 * int(views[start])
            device.paste(rows[first : first + 3 * (end - start)], own, 3 * start)
        made = haar.forward(device, own)
        for start, end in runs:
            device.paste(made[3 * start : 3 * end], coefficients, 3 * int(views[start]))
