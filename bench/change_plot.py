"""Error against time of what bench/change.py measured, prtcl's settings beside Mitsuba's curve.

python bench/change_plot.py bench/results/change_view.json bench/results/change_light.json -o docs/images/change.png
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Error against time, a panel a material and kind of change."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    kinds, materials = (list(dict.fromkeys(row[key] for row in rows)) for key in ("kind", "material"))
    environments = list(dict.fromkeys(row["environment"] for row in rows))
    figure, axes = plt.subplots(
        len(kinds),
        len(materials),
        figsize=(5.2 * len(materials), 4.4 * len(kinds)),
        squeeze=False,
        sharey="row",
    )
    for panel, kind in zip(axes, kinds, strict=True):
        for ax, material in zip(panel, materials, strict=True):
            here = [row for row in rows if (row["kind"], row["material"]) == (kind, material)]
            for environment, change in dict.fromkeys((row["environment"], row["change"]) for row in here):
                own = [row for row in here if (row["environment"], row["change"]) == (environment, change)]
                colour = f"C{environments.index(environment)}"
                turned = change == "the same, turned"
                name = environment + (", turned" if turned else "")
                line = ":" if turned else "--"
                _, seconds, noise = np.array(own[0]["mitsuba"]).T
                ax.plot(seconds, 100 * noise, line, marker=".", color=colour, label=f"Mitsuba 3, {name}")
                _, seconds, noise = np.array(own[0]["mitsuba"][-1:] + own[0]["mitsuba_beyond"]).T
                ax.plot(seconds, 100 * noise, line, color=colour, alpha=0.4)
                ours = sorted((row["seconds"], 100 * row["error"]) for row in own)
                ax.plot(
                    *zip(*ours, strict=True), "-", marker="o", markersize=8, color=colour, label=f"prtcl, {name}",
                    fillstyle="none" if turned else "full",
                )  # fmt: skip
            what = "new view and material" if kind == "view+brdf" else "new light"
            ax.set(
                xscale="log",
                yscale="log",
                xlabel="seconds",
                title=f"{what}, {here[0]['points']:,} points\n{material}",
            )
            ax.grid(True, which="both", alpha=0.25)
        panel[0].set_ylabel("relative RMSE, %")
        panel[-1].legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.02, 1.0))
    figure.suptitle(
        "Error against time on the same cores; pale: Mitsuba's noise at a part of the points, time scaled"
    )
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="+", type=Path, metavar="FILE.json")
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="PATH.png")
    options = parser.parse_args()
    rows = [row for file in options.results for row in json.loads(file.read_text(encoding="utf-8"))["rows"]]
    plot(rows, options.output)


if __name__ == "__main__":
    main()
