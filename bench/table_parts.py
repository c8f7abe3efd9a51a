"""How measured tables split into parts, and how well `sharpen` and `balance` keep their energy.

    python bench/table_parts.py [-o bench/results/table_parts.json]

Every material of ../shared/data/brdfs in two angles (bench/networks.py). For each the share of the light at 30 degrees
that is diffuse; for each edit the least and the largest of albedo after over before, over incidences and channels, and
the energy after.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import networks
import numpy as np
import scenes

from prtcl.factors.albedo import INCIDENCES, albedo, energy
from prtcl.factors.table_parts import INCIDENCE, balance, sharpen, split

EDITS = {
    "sharpen 2": lambda table: sharpen(table, 2.0), "sharpen 0.5": lambda table: sharpen(table, 0.5),
    "balance 0.5": lambda table: balance(table, 0.5), "balance -0.5": lambda table: balance(table, -0.5),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    rows = []
    for source in networks.SOURCES:
        for name in networks.names(source):
            own = networks.measured(source, name).bivariate()
            before = albedo(own, INCIDENCES)
            share = float((albedo(split(own)[0], [INCIDENCE]) / albedo(own, [INCIDENCE])).mean())
            row: dict[str, object] = {"material": name, "diffuse": share, "energy": energy(own)[0]}
            for what, edit in EDITS.items():
                after = edit(own)
                ratio = albedo(after, INCIDENCES) / before
                row[what] = {"least": ratio.min(), "most": ratio.max(), "energy": energy(after)[0]}
            rows.append(row)
            edits = "; ".join(f"{what} {row[what]['least']:.3f} to {row[what]['most']:.3f}" for what in EDITS)  # type: ignore[index]
            print(f"{name:24} {share:.2f} diffuse; {edits}", flush=True)
    for what in EDITS:
        worst = np.array([max(row[what]["most"] - 1, 1 - row[what]["least"]) for row in rows])  # type: ignore[index]
        print(f"{what}: off by {np.median(worst):.1%} in the median material, {worst.max():.0%} in the worst")
    scenes.save(options.output, command="python bench/table_parts.py", rows=rows)


if __name__ == "__main__":
    main()
