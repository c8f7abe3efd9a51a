"""`prtcl brdf`: a material's figures and plots; conversion of measured files."""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from prtcl.apps import brdf_plots
from prtcl.apps.figures import require
from prtcl.errors import InputError
from prtcl.factors.analytic import evaluate
from prtcl.factors.bivariate import Bivariate, directions, merl_nodes
from prtcl.factors.material import MEASURED, Material
from prtcl.factors.measured import MERL_TURNS, Measured, turns
from prtcl.factors.measured_files import EXTENSIONS, read_measured
from prtcl.factors.reduction import Brdf, in_two_angles, reduction_error
from prtcl.factors.sampled_albedo import sampled_albedo
from prtcl.factors.table_edit import resample
from prtcl.factors.tabulate import tabulate
from prtcl.files.atomic import check_not_input, check_writable, made_folder
from prtcl.files.merl import SHAPE, write_merl

ANGLES = (0.0, 45.0, 75.0)
"""Degrees from the normal at which the summary gives albedos."""
STEEPEST = 85.0
"""Degrees up to which albedos are asked whether they exceed 1; measurements nearer to the horizon are rare."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A material as this command looks at it: f, and the tables it is made of, where it is."""

    name: str
    kind: str
    f: Brdf
    measured: Measured | None
    table: Bivariate | None
    notes: tuple[str, ...]
    path: str | None = None
    material: Material | str = ""

    def three_angles(self) -> Measured:
        """What it is in MERL's layout; what a table was not told is not measured there either."""
        if self.measured is not None and self.measured.valid.shape == SHAPE:
            return self.measured
        own = Measured.sample(self.f, name=self.name)
        if self.table is None or self.table.valid.all():
            return own
        near = resample(self.table, own.theta_h, own.theta_d)
        return Measured.make(
            own.values, own.theta_h, own.theta_d, own.valid & near.valid[..., None], name=self.name
        )

    def two_angles(self) -> Bivariate:
        """What it is without φ_d."""
        if self.table is not None:
            return self.table
        return self.measured.bivariate() if self.measured is not None else tabulate(self.material)


def run(options: argparse.Namespace) -> int:
    """Print the summary, draw and convert.

    Raises
    ------
    InputError
        If the material cannot be read, an output cannot be written, or matplotlib is missing.
    """
    if options.write is not None:
        ending = os.path.splitext(options.write)[1].lower()
        if ending not in (".npz", ".binary"):
            raise InputError(f"--write {options.write}: expected a name that ends in .npz or .binary")
        check_writable(options.write)
    if options.output is not None:
        require()
    subject = load(options.material)
    if options.write is not None and subject.path is not None:
        check_not_input(options.write, subject.path)
    figures = summary(subject)
    if options.write is not None:
        written: Brdf
        if ending == ".npz":
            table = subject.two_angles()
            table.save(options.write)
            written = in_two_angles(table)
        else:
            own = subject.three_angles()
            write_merl(options.write, own.values, own.valid)
            written = own.evaluate
        before, after = (sampled_albedo(f, np.radians(ANGLES)) for f in (subject.f, written))
        off = float(np.abs(after - before).max() / max(float(before.max()), 1e-30))
        if off > 0.01:
            figures["notes"].append(
                f"{options.write}: its nodes are too coarse for this lobe: albedos are off by {100 * off:.2g} %"
            )
    if options.output is not None:
        folder = made_folder(options.output)
        figures["plots"] = [
            str(p) for p in brdf_plots.write(subject.name, subject.f, subject.measured, folder)
        ]
    if options.json:
        print(json.dumps(figures, indent=2))
    elif not options.quiet:
        print(text(figures))
    return 0


def load(given: str) -> Subject:
    """A file by its ending, or a SPEC.

    Raises
    ------
    InputError
        If it is neither.
    """
    kind, colon, rest = given.partition(":")
    ending = Path(given).suffix.lower()
    # A path may have a colon in it; a file that is there is meant.
    if Path(given).exists() or not colon:
        if ending == ".npz":
            kind, given = "table", f"table:{given}"
        elif ending in EXTENSIONS:
            kind, given = EXTENSIONS[ending], f"{EXTENSIONS[ending]}:{given}"
        elif Path(given).exists():
            raise InputError(f"{given}: expected a BRDF whose name ends in .npz, {', '.join(EXTENSIONS)}")
        rest = given.partition(":")[2]
    if kind == "table":
        table = Bivariate.load(rest)
        return Subject(given, "table", in_two_angles(table), None, table, table.notes, rest)
    if kind in MEASURED:
        found = read_measured(given)
        if isinstance(found, Bivariate):
            return Subject(
                given, f"{kind}, two angles", in_two_angles(found), None, found, found.notes, found.name
            )
        return Subject(given, kind, found.evaluate, found, None, found.notes, found.name)
    material = Material.parse(given)
    return Subject(
        given, material.kind, partial(evaluate, material), None, None, material.notes, None, material
    )


def summary(subject: Subject) -> dict[str, Any]:
    """The figures, as JSON has them; shares are from 0 to 1, albedos RGB."""
    out: dict[str, Any] = {"material": subject.name, "kind": subject.kind}
    if subject.measured is not None:
        own = subject.measured
        out["nodes"] = list(own.valid.shape)
        # Of what can be seen: where a direction is below the horizon there is nothing to measure.
        out["valid_share"] = float(own.valid[own.above].mean())
        out["invalid_samples"] = int((~own.valid).sum())
        out["largest"] = float(own.values[own.valid & own.above].max())
        norm, rmse = reduction_error(own)
        out["two_angles"] = {"norm": norm, "rmse": rmse}
    elif subject.table is not None:
        table = subject.table
        out["nodes"], out["valid_share"] = list(table.shape), float(table.valid.mean())
        out["largest"] = float(table.values.max())
    else:
        h, d = merl_nodes()
        i, o = directions(h[:, None, None], d[:, None], turns(MERL_TURNS)[::30])
        above = (i[..., 2] > 0) & (o[..., 2] > 0)
        out["largest"] = float(subject.f(i[above], o[above]).max())
    out["albedo"] = {
        f"{angle:g}": [float(v) for v in row]
        for angle, row in zip(ANGLES, sampled_albedo(subject.f, np.radians(ANGLES)), strict=True)
    }
    steps = np.linspace(0.0, STEEPEST, 18)
    every = sampled_albedo(subject.f, np.radians(steps))
    at = np.unravel_index(int(every.argmax()), every.shape)
    out["largest_albedo"], out["largest_albedo_at"] = float(every.max()), float(steps[at[0]])
    # A hundredth is what the quadrature may be off by.
    out["conserves_energy"] = bool(every.max() <= 1.01)
    out["notes"] = list(subject.notes)
    return out


def text(figures: dict[str, Any]) -> str:
    """The summary for people."""
    lines = [f"{figures['material']}: {figures['kind']}"]
    if "nodes" in figures:
        lines.append(
            f"  nodes {' x '.join(map(str, figures['nodes']))}, {100 * figures['valid_share']:.4g} % measured"
        )
    for angle, rgb in figures["albedo"].items():
        lines.append(f"  albedo at {angle:>2} degrees  " + "  ".join(f"{v:.4f}" for v in rgb))
    kept = "conserves energy" if figures["conserves_energy"] else "reflects more than it receives"
    lines.append(
        f"  {kept}: albedo up to {figures['largest_albedo']:.4f}, at {figures['largest_albedo_at']:g} degrees, of all "
        f"up to {STEEPEST:g}"
    )
    lines.append(f"  largest value {figures['largest']:.4g} /sr")
    if "two_angles" in figures:
        own = figures["two_angles"]
        lines.append(
            f"  two angles instead of three: {100 * own['norm']:.1f} % in the cosine-weighted norm, "
            f"{100 * own['rmse']:.0f} % RMSE over directions"
        )
    lines += [f"  {note}" for note in figures["notes"]]
    lines += [f"  wrote {path}" for path in figures.get("plots", ())]
    return "\n".join(lines)
