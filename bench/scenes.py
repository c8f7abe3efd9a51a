"""The acceptance scenes: meshes × environments × materials of ../shared/data, which the repository does not ship."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

DATA = Path(os.environ.get("PRTCL_DATA", Path(__file__).resolve().parent.parent.parent / "shared" / "data"))

MESHES = ("stanford_bunny", "nefertiti", "bob")
ENVIRONMENTS = ("modern_buildings_2", "st_fagans_interior", "st_peters_square_night")
MATERIALS = ("lambert:albedo=0.5", "ggx:alpha=0.3,eta=0.2,k=3.0", "ggx:alpha=0.1,eta=0.2,k=3.0")
LIMITS = (0.01, 0.01, 0.03)
"""The relative RMSE the issue asks for, material by material."""


def require_data() -> None:
    """Leave with a reason where the data is absent."""
    if not DATA.is_dir():
        sys.exit(
            f"{DATA}: the acceptance meshes and environments are not there; set PRTCL_DATA to their folder"
        )


def mesh_path(name: str) -> Path:
    return DATA / "meshes" / f"{name}.ply"


def environment_path(name: str) -> Path:
    return DATA / "environments" / f"{name}.exr"


def save(output: Path | None, **result: object) -> None:
    """Write a benchmark's JSON aside and rename it, where a file is named."""
    from prtcl.files.atomic import replacing

    if output is not None:
        with replacing(output) as aside:
            aside.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def relative_rmse(image, reference) -> float:  # type: ignore[no-untyped-def]
    """Over the pixels either image covers and all channels, relative to the reference's mean there."""
    import numpy as np

    covered = (image[..., 3] > 0) | (reference[..., 3] > 0)
    a, b = image[covered][:, :3].astype(np.float64), reference[covered][:, :3].astype(np.float64)
    return float(np.sqrt(((a - b) ** 2).mean()) / b.mean())
