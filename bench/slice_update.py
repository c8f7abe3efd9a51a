"""A local edit of a table's slices against making them anew.

    python bench/slice_update.py [-o bench/results/slice_update.json]

A 6 × 6 patch of a 90 × 90 table (GGX α = 0.2 sampled at MERL's nodes), 128 polar views, 4^6 directions, three channels.
`edit` is the whole of it, from a NumPy table to coefficients on the device: what changed, which cells read it, those
cells, the transform of the slices they are in. `rebuild` makes all samples and transforms them, as `Materials.slices`
does; both end with the device idle. The coefficients of both are compared bit for bit. Medians of `RUNS` after a
warm-up.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import scenes

from prtcl import reference
from prtcl.compute.device import Device
from prtcl.factors.bivariate import Bivariate, directions, merl_nodes
from prtcl.factors.material import Material
from prtcl.factors.slices import Materials, ViewTable, subsamples
from prtcl.factors.table_slices import TableSlices

RUNS, LEVELS, VIEWS, PATCH = 9, 6, 128, 6
PLACES = ((10, 5), (20, 40), (45, 20), (60, 60), (80, 45))


def table() -> Bivariate:
    """Coloured GGX at φ_d = 90 degrees, where both directions are above the horizon at every node."""
    h, d = merl_nodes()
    incident, outgoing = directions(h[:, None], d, np.pi / 2)
    material = {"kind": "ggx", "alpha": 0.2, "f0": (0.9, 0.6, 0.3)}
    return Bivariate.make(reference.brdf(material, incident, outgoing), h, d)


def timed(device: Device, run: Callable[[int], object]) -> float:
    """Median milliseconds until the device is idle, of runs 0, 1, …"""
    seconds = []
    for number in range(RUNS + 1):
        device.queue.finish()
        start = time.perf_counter()
        run(number)
        device.queue.finish()
        seconds.append(time.perf_counter() - start)
    return 1e3 * median(seconds[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    device, first = Device(), table()
    views = ViewTable.make(True, VIEWS).views
    sub = subsamples(first.material(), LEVELS)
    start = time.perf_counter()
    kept = TableSlices(device, first, views, LEVELS)
    device.queue.finish()
    once = 1e3 * (time.perf_counter() - start)
    rows = []
    for h, d in PLACES:
        where = slice(h, h + PATCH), slice(d, d + PATCH)

        def edited(number: int, where: tuple[slice, slice] = where) -> np.ndarray:  # type: ignore[type-arg]
            values = first.values.copy()
            values[where] *= 1.5 + 0.1 * number
            return values

        edit = timed(device, lambda number: kept.update(edited(number)))
        own = Bivariate.make(edited(RUNS), first.theta_h, first.theta_d).material()

        def anew(_: int, own: Material = own) -> object:
            return Materials(device, [own]).slices(views, LEVELS, sub)

        rebuild = timed(device, anew)
        whole = Materials(device, [own]).slices(views, LEVELS, sub).get()[0]
        same = bool((whole == kept.coefficients.get()).all())
        rows.append(
            {"theta_h": h, "theta_d": d, "edit_ms": edit, "rebuild_ms": rebuild, "times": rebuild / edit,
             "cells": kept.made / (VIEWS * 4**LEVELS), "slices": kept.transformed, "same_bits": same}
        )  # fmt: skip
        print(
            f"nodes {h}, {d}: {edit:.1f} ms, anew {rebuild:.1f} ms, {rebuild / edit:.1f} times; "
            f"{100 * rows[-1]['cells']:.2f} % of the cells, {kept.transformed} slices, same bits: {same}",
            flush=True,
        )
        kept.update(first.values)
        if not same:
            raise SystemExit("an edit's coefficients differ from a rebuild's")
    scenes.save(
        options.output, device=device.name, driver=device.driver, command="python bench/slice_update.py",
        levels=LEVELS, views=VIEWS, sub=sub, nodes=first.shape, patch=PATCH, runs=RUNS, made_once_ms=once,
        rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
