"""Editing: frame time and error of a session's materials, at a mesh's vertices.

    python bench/editing.py [--mesh stanford_bunny] [--environment modern_buildings_2] [-o bench/results/editing.json]

A frame is a new view and a new material, 40,000 points shaded anew: the vertices that face the eye, some of them twice
where there are fewer. Visibility and L + V are there (their seconds are shown, too). `cut error` is against the same
session's exact mode, over the vertices by the area they show; `error` against equation (1) on 256 x 256 directions in
float64 at a sample of vertices, rays by embree. Medians of nine frames after a warm-up.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from statistics import median

import numpy as np
import scenes
from exact import Exact

from prtcl.compute.device import Device
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.scene.points import vertex_points
from prtcl.scene.session import Session

SPECS = ("lambert:albedo=0.5", "ggx:alpha=0.3,eta=0.2,k=3.0", "ggx:alpha=0.3,f0=0.04,kd=0.5",
         "ggx:alpha=0.1,eta=0.2,k=3.0", "ggx:alpha=0.05,eta=0.2,k=3.0")  # fmt: skip
FRAMES, LEVELS, PEAK_SIDE, POINTS = 9, 8, 2, 40_000


def truth(  # type: ignore[no-untyped-def]
    session: Session, vertices: np.ndarray, eyes: np.ndarray, specs=SPECS, light: Environment | None = None
):
    """(materials, vertices, 3) by the definition: soft light on 4^8 directions, its peaks by half texels.

    Parameters
    ----------
    eyes : (3,), or (vertices, 3)
    light : None is the session's; not turned
    """
    exact = Exact(light or session.light, session.tracer, LEVELS, PEAK_SIDE)
    points = vertex_points(session.mesh, session.tracer, None, vertices)
    towards = np.asarray(eyes) - session.mesh.vertices[vertices]
    materials = [Material.parse(spec).reference() for spec in specs]
    out = np.zeros((len(specs), len(vertices), 3))
    for i in range(len(vertices)):
        axes = points.frames[i].astype(np.float64)
        view = axes @ towards[i]
        out[:, i] = exact.radiance(points.origins[i : i + 1], axes, view / np.linalg.norm(view), materials)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh", default="stanford_bunny")
    parser.add_argument("--environment", default="modern_buildings_2")
    parser.add_argument("--sample", type=int, default=100)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    scenes.require_data()
    device = Device()
    session = Session(
        scenes.mesh_path(options.mesh), scenes.environment_path(options.environment), device=device
    )
    mesh, eye = session.mesh, np.asarray(session.camera.eye)
    towards = eye - mesh.vertices
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    facing = np.flatnonzero((towards * mesh.normals).sum(axis=1) > 0)
    session.radiance(tuple(eye), facing)
    once = {k: round(v, 2) for k, v in session.last.seconds.items()}
    print(f"{len(mesh.vertices)} vertices, {len(facing)} face the eye; once: {once}")
    rng = np.random.default_rng(5)
    well = np.flatnonzero((towards * mesh.normals).sum(axis=1) > 0.15)
    some = np.sort(rng.choice(well, options.sample, replace=False))
    exact_truth = truth(session, some, eye)
    shown = (towards * mesh.normals).sum(axis=1)[facing]
    shaded = np.resize(facing, max(POINTS, len(facing)))
    rows = []
    for m, spec in enumerate(SPECS):
        session.material = spec
        session.error = 0.0
        exact = session.radiance(tuple(eye), facing)
        session.error = 0.01
        start = time.perf_counter()
        got = session.radiance(tuple(eye), facing)
        first = time.perf_counter() - start
        sampled = session.radiance(tuple(eye), some)
        seconds = []
        device.profile.reset()
        for frame in range(FRAMES + 1):
            session.material = session.material  # dressed anew, as an edit does
            start = time.perf_counter()
            session.radiance(tuple(eye + 1e-3 * frame * mesh.scale), shaded)
            seconds.append(time.perf_counter() - start)
        stages = {k: round(1e3 * v / (FRAMES + 1), 2) for k, v in device.profile.device_seconds().items()}
        rows.append(
            {
                "material": spec, "frames_per_second": 1 / median(seconds[1:]),
                "milliseconds": 1e3 * median(seconds[1:]),
                "first_with_a_new_cut_ms": 1e3 * first, "device_ms": stages,
                "hard_nodes": 0 if session._outfit.full.hard is None else len(session._outfit.full.hard[0]),
                "leaves": len(session._outfit.full.cuts[0].leaves) / 136,  # type: ignore[union-attr]
                "cut_error": rmse(got, exact, shown), "error": rmse(sampled, exact_truth[m], np.ones(len(some))),
            }
        )  # fmt: skip
        row = rows[-1]
        print(
            f"{spec:30} {row['milliseconds']:.1f} ms ({row['frames_per_second']:.1f}/s), new cut "
            f"{row['first_with_a_new_cut_ms']:.0f} ms, {row['leaves']:.0f} leaves, "
            f"cut error {100 * row['cut_error']:.2f} %, error {100 * row['error']:.2f} %, {stages}",
            flush=True,
        )
    scenes.save(
        options.output, device=device.name, driver=device.handle.driver_version,
        command="python bench/editing.py", mesh=options.mesh, environment=options.environment,
        vertices=len(mesh.vertices), facing=len(facing), shaded=len(shaded), once_seconds=once, rows=rows,
    )  # fmt: skip


def rmse(got: np.ndarray, exact: np.ndarray, weight: np.ndarray) -> float:  # type: ignore[type-arg]
    """Relative to the mean, rows weighted."""
    square = np.average(((got.astype(np.float64) - exact) ** 2).mean(axis=1), weights=weight)
    return float(np.sqrt(square) / np.average(exact.mean(axis=1), weights=weight))


if __name__ == "__main__":
    main()
