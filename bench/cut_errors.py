"""What a session's cuts cost against what they say: meshes, lights and materials that nothing was tuned on.

    python bench/cut_errors.py [-o bench/results/cut_errors.json]

One view each, at 4^6 directions: relative RMSE over the covered pixels of `error=0.01` against `error=0`, beside the
`expected_error` that the view reports.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scenes

from prtcl.compute.device import Device
from prtcl.factors.material import Material, from_table
from prtcl.scene.camera import Camera
from prtcl.scene.session import Session

MESHES, ENVIRONMENTS = ("spot", "koala"), ("venice_sunset", "kloppenheim_05", "studio_small_03")
SPECS = ("lambert:albedo=0.5", "ggx:alpha=0.3,eta=0.2/0.9/1.3,k=3.9/2.4/2.0", "ggx:alpha=0.1,f0=1/0.78/0.34",
         "ggx:alpha=0.05,f0=0.9", "ggx:alpha=0.02,f0=0.9", "ggx:alpha=0.15,f0=0.04,kd=0.5/0.03/0.03",
         "blinn:exponent=2000,ks=0.5,kd=0.1")  # fmt: skip
ERROR = 0.01


def table() -> Material:
    """A narrow lobe on a base."""
    theta_h, theta_d = np.linspace(0, np.pi / 2, 40), np.linspace(0, np.pi / 2, 10)
    lobe = 0.05 + 3 * np.exp(-((theta_h[:, None] / 0.1) ** 2)) * np.ones(10)
    return from_table(lobe, theta_h, theta_d, name="a table")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    device, rows = Device(), []
    for mesh in MESHES:
        for environment in ENVIRONMENTS:
            session = Session(scenes.mesh_path(mesh), scenes.environment_path(environment), device=device)
            session.camera = Camera.framing(session.mesh.bounds, size=(90, 70))
            for material in (*(Material.parse(spec) for spec in SPECS), table()):
                session.material = material
                session.error = 0.0
                exact = session.view().image.astype(np.float64)
                session.error = ERROR
                made = session.view()
                covered = exact[..., 3] > 0
                off = (made.image - exact)[covered][:, :3]
                mean = exact[covered][:, :3].mean()
                row = {
                    "mesh": mesh, "environment": environment, "material": material.spec,
                    "relative_rmse": scenes.relative_rmse(made.image, exact), "bias": float(off.mean() / mean),
                    "expected": made.report["expected_error"],
                }  # fmt: skip
                rows.append(row)
                print(
                    f"{mesh:6} {environment:18} {material.spec:46} {100 * row['relative_rmse']:.2f} % "
                    f"(bias {100 * row['bias']:+.2f} %, expected {100 * row['expected']:.2f} %)",
                    flush=True,
                )
    found = np.array([row["relative_rmse"] for row in rows])
    print(
        f"{(found <= ERROR).sum()} of {len(found)} at most {100 * ERROR:g} %, the largest {100 * found.max():.2f} %"
    )
    scenes.save(
        options.output, device=device.name, command="python bench/cut_errors.py", error=ERROR, rows=rows
    )


if __name__ == "__main__":
    main()
