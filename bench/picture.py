"""The README's picture: Nefertiti as plaster, gold and glaze, `prtcl render` at its defaults with `--smooth`.

python bench/picture.py [-o docs/images/nefertiti.png]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scenes

from prtcl.compute.device import Device
from prtcl.files.image import write_png
from prtcl.scene.camera import Camera
from prtcl.scene.scene import Scene

PANELS = (
    ("modern_buildings_2", "lambert:albedo=0.75/0.72/0.68", -1.6),
    ("modern_buildings_2", "ggx:alpha=0.3,f0=1.0/0.78/0.34", -1.6),
    ("st_fagans_interior", "ggx:alpha=0.1,f0=0.05,kd=0.05/0.25/0.12", 0.6),
)
"""Environment, material, exposure in stops."""
MARGIN = 16


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    root = Path(__file__).resolve().parent.parent
    parser.add_argument("-o", "--output", type=Path, default=root / "docs" / "images" / "nefertiti.png")
    options = parser.parse_args()
    scenes.require_data()
    device, panels = Device(), []
    for environment, spec, exposure in PANELS:
        scene = Scene(
            scenes.mesh_path("nefertiti"),
            scenes.environment_path(environment),
            spec,
            device=device,
            smooth=True,
        )
        scene.camera = Camera.framing(scene.mesh.bounds, size=(300, 400))
        render = scene.render()
        print(f"{spec}: {render.report['seconds']['total']:.1f} s on {device.name}")
        image = render.image.astype(np.float64)
        image[..., :3] *= 2.0**exposure
        panels.append(image)
    # All three show the same view: cut to what is seen, and a margin.
    rows, columns = np.nonzero(panels[0][..., 3] > 0)
    shown = (
        slice(rows.min() - MARGIN, rows.max() + MARGIN),
        slice(columns.min() - MARGIN, columns.max() + MARGIN),
    )
    write_png(options.output, np.concatenate([panel[shown] for panel in panels], axis=1))


if __name__ == "__main__":
    main()
