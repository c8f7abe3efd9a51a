"""The same input on the same device gives the same bytes in another process.

In one process: tests/test_scene_render.py (test_the_same_scene_gives_the_same_bits) and tests/test_session.py
(test_edits_in_a_row_end_where_a_fresh_session_starts).
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from prtcl.compute import choice
from prtcl.factors.environment import Environment
from prtcl.files.image import write_exr
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh

ROOT = Path(__file__).resolve().parents[1]
VIEW = Camera((3.1, 2.5, 5.4), (-0.1, 0.75, -0.3), fov=38.0, size=(20, 15))
SPEC = "ggx:alpha=0.3,f0=0.5/0.6/0.3,kd=0.3"


def test_two_processes_write_the_same_file(
    mesh: Mesh, sky: Environment, tmp_path: Path, opencl_device: choice.Seen
) -> None:
    """Adaptive points, hard light, threads: nothing of it depends on what finishes first."""
    import trimesh

    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(tmp_path / "mesh.ply")
    write_exr(tmp_path / "sky.exr", np.dstack([sky.image, np.ones(sky.image.shape[:2], np.float32)]))
    files = []
    for name, seed in (("a", "1"), ("b", "2")):
        command = [
            sys.executable, "-m", "prtcl", "render", "mesh.ply", "--env", "sky.exr", "--brdf", SPEC, "--size", "24x18",
            "--device", opencl_device.spec, "--quiet", "--error-channel", "-o", f"{name}.exr",
        ]  # fmt: skip
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=240)
        files.append((tmp_path / f"{name}.exr").read_bytes())
    assert files[0] == files[1]
