"""What two angles cost: every material of shared/data/brdfs in three angles against its bivariate table.

    python bench/reduction.py [-o bench/results/reduction.json] [--points 48] [--samples 64]

The networks of bench/networks.py are evaluated at MERL's bin centres, both orders averaged, then reduced by
`Measured.bivariate`. Errors are those of `prtcl.factors.reduction`: in the cosine-weighted norm over all pairs of
directions, as relative RMSE with the same weights, and as relative RMSE of an unshadowed sphere's picture under a sunny
and under a soft environment. The picture's figures are made twice with other random numbers, whose difference is its
noise. Networks are checked against test_vectors.json first; a Markdown table is printed.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import networks
import numpy as np
import scenes

from prtcl.factors.reduction import radiance_change, reduction_error
from prtcl.files.radiance import read_radiance

ENVIRONMENTS = {"sunny": "kloppenheim_05", "soft": "lebombo"}


def check_networks() -> float:
    """The largest relative difference from the published vectors."""
    worst = 0.0
    for vector in json.loads((networks.FOLDER / "test_vectors.json").read_text(encoding="utf-8")):
        source = next(s for s in networks.SOURCES if vector["material"] in networks.names(s))
        f, i, o = networks.load(source, vector["material"]), *(np.array([vector[k]]) for k in ("wi", "wo"))
        both = (f(i, o) + f(o, i))[0] / 2
        worst = max(worst, float(np.abs(both / vector["f_sym"] - 1).max()))
    return worst


def row(source: str, name: str, maps: dict[str, np.ndarray], points: int, samples: int) -> dict[str, object]:  # type: ignore[type-arg]
    """One material's figures."""
    measured = networks.measured(source, name)
    reduced = measured.bivariate()
    share, rmse = reduction_error(measured, reduced)
    out: dict[str, object] = {"material": name, "source": source, "norm": share, "rmse": rmse}
    for key, image in maps.items():
        both = [
            radiance_change(measured, image, reduced, points=points, samples=samples, seed=seed)
            for seed in (0, 1)
        ]
        out[key], out[f"{key}_noise"] = float(np.mean(both)), abs(both[0] - both[1]) / 2
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--points", type=int, default=48)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--materials", nargs="*", help="only these (default: all)")
    options = parser.parse_args()
    scenes.require_data()
    started = time.perf_counter()
    worst = check_networks()
    if worst > 1e-6:
        raise SystemExit(f"the networks differ from test_vectors.json by {worst:.2g}")
    maps = {key: read_radiance(scenes.environment_path(name))[0] for key, name in ENVIRONMENTS.items()}
    rows = []
    print(
        "| material | norm | RMSE over directions | sunny sphere | soft sphere |\n|---|---|---|---|---|",
        flush=True,
    )
    for source in networks.SOURCES:
        for name in networks.names(source):
            if options.materials and name not in options.materials:
                continue
            own = row(source, name, maps, options.points, options.samples)
            rows.append(own)
            cells = " | ".join(f"{100 * own[key]:.1f} %" for key in ("norm", "rmse", *ENVIRONMENTS))  # type: ignore[operator]
            print(f"| {name} | {cells} |", flush=True)
    medians = {key: float(np.median([r[key] for r in rows])) for key in ("norm", "rmse", *ENVIRONMENTS)}  # type: ignore[arg-type]
    print("| median | " + " | ".join(f"{100 * value:.1f} %" for value in medians.values()) + " |")
    command = f"python bench/reduction.py --points {options.points} --samples {options.samples}"
    scenes.save(
        options.output, command=command, environments=ENVIRONMENTS, test_vectors_worst=worst,
        points=options.points, samples=options.samples, seconds=time.perf_counter() - started,
        medians=medians, rows=rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
