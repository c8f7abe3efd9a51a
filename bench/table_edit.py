"""How long a session takes from an edit of a table to the picture, and how long the edits themselves take.

    python bench/table_edit.py [-o bench/results/table_edit.json]

A subdivided ball on a floor under sun and sky, 4^6 directions. Medians of five edits of the slider's kind; the first
view, which traces and compiles, is not among them.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from functools import partial
from itertools import product
from pathlib import Path

import trimesh

import prtcl
from prtcl.factors.albedo import energy

EDITS = {
    "tint": lambda table, k: table.tinted(1.0 - 0.05 * k, 1.0, 1.0),
    "sharpen": lambda table, k: table.sharpened(1.1 + 0.05 * k),
    "balance": lambda table, k: table.balanced(0.1 + 0.05 * k),
}


def scene() -> prtcl.Mesh:
    ball = trimesh.creation.icosphere(subdivisions=5)
    floor = trimesh.creation.box((5, 0.2, 5))
    for _ in range(5):
        floor = floor.subdivide()
    floor.apply_translation((0, -1.1, 0))
    both = trimesh.util.concatenate([ball, floor])
    return prtcl.Mesh.from_arrays(both.vertices, both.faces, name="ball")


def timed(work):  # type: ignore[no-untyped-def]
    start = time.perf_counter()
    out = work()
    return out, 1e3 * (time.perf_counter() - start)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--output", type=Path)
    output = parser.parse_args().output
    sky = prtcl.Environment(prtcl.sun_sky(128, sun_elevation=35.0))
    camera = prtcl.Camera((2.5, 2.0, 4.0), (0, -0.2, 0), fov=35.0, size=(480, 360))
    session = prtcl.Session(scene(), sky, "lambert:albedo=0.5", camera)
    session.view()
    rows = {}
    for spec in ("ggx:alpha=0.3,f0=0.04,kd=0.5/0.2/0.1", "ggx:alpha=0.1,f0=1.0/0.77/0.34"):
        start, spent = timed(partial(prtcl.Table.of, spec))
        own: dict[str, object] = {"tabulate_ms": round(spent, 1)}
        session.material = spec
        session.view()
        for (name, edit), draft in product(EDITS.items(), (True, False)):
            stages: dict[str, list[float]] = {}
            errors = []
            for k in range(5):
                table, spent = timed(partial(edit, start, k))
                stages.setdefault("edit", []).append(spent)
                stages.setdefault("energy", []).append(timed(partial(energy, table.bivariate))[1])
                table, _ = timed(partial(session.edit, lambda worn, table=table: table))
                render, spent = timed(partial(session.view, draft=draft))
                stages.setdefault("picture", []).append(spent)
                for stage, seconds in session.last.seconds.items():
                    stages.setdefault(stage, []).append(1e3 * seconds)
                errors.append(render.report["expected_error"])
                session.undo()
            medians: dict[str, float] = {
                stage: round(statistics.median(ms), 1) for stage, ms in stages.items()
            }
            own[name + (" (draft)" if draft else "")] = {**medians, "expected_error": round(max(errors), 4)}
        session.edit(lambda table: table.scaled(0.9))
        session.view()
        session.undo()
        session.view()
        own["undo"] = {stage: round(1e3 * s, 1) for stage, s in session.last.seconds.items()}
        rows[spec] = own
    report = {
        "device": session.device.name,
        "vertices": len(session.mesh.vertices),
        "levels": 6,
        "rows": rows,
    }
    print(json.dumps(report, indent=2))
    if output is not None:
        output.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
